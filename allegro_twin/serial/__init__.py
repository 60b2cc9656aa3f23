"""Hands on a serial line. `line`: what every such hand needs; `dynamixel`: hands made of DYNAMIXEL servos; `polled`:
what hands have in common that answer when they are asked, of which `qb` and `schunk` are two."""
