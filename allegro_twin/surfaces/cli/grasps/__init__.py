"""Commands that plan, improve, evaluate and compare grasps."""
