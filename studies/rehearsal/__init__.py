"""The rehearsal of reality: what grasps and motions that were made on a twin lose on hands that nobody has seen."""
