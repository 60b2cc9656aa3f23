"""The lab's cell as an environment: take a thing off the table."""
