"""For people who look at a bus: a checkup of the link, a sniffer, logs and the recordings made of them."""
