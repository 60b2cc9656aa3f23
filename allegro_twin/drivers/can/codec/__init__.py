"""CAN codec: messages in SI units, the frames of every version of the hand, and the calibration between them."""
