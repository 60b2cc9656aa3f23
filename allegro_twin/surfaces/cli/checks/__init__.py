"""What `allegro-twin doctor` looks at: each check is a function of the machine that gives findings."""
