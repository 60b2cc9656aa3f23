"""From a depth camera's points to what stands on the table and where a hand should go: functions of arrays."""
