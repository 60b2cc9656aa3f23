"""Open a simulated hand, move it, and read where it is."""

from allegro_twin import Hand

with Hand.open("sim_right") as hand:
    hand.move_to("home", speed=1.0)  # rad/s of the joint that travels furthest; all fingers arrive together
    print(f"after {hand.state.t:.2f} s, largest error {abs(hand.errors).max() * 1000:.1f} mrad")
    for name, pose in hand.fingertips().items():
        print(f"{name:7s} {pose.position.round(4)} m in the palm frame")
    assert abs(hand.errors).max() < 0.005  # rad
    assert hand.state.t < 3.0  # s
