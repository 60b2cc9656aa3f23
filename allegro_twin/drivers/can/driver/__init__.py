"""The computer's end of the bus: the backend, how it reads, what it does when something dies or is late."""
