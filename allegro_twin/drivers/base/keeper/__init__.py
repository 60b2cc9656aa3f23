"""The process that leaves a hand limp when the program that drives it dies or stalls: `keeper` starts it, `process` is
what runs in it."""
