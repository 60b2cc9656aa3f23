"""Closed forms of the Allegro's fingers and thumb.

`finger.py` is the door: it reads a request (`targets.py`) and solves it for one pose on plain numbers (`one_pose.py`)
or for many in arrays (`many_poses.py`). Both use the formulas in `forms/`, which take a number or an array. Where a
formula does not say which posture, `redundancy/` chooses from the curve of all postures that reach a point; where none
reaches it, `nearest/` finds the one that comes nearest. `scalar.py` solves for a control loop, without arrays.

All of it solves right fingers; a left one is the mirror image (`geometry.py`). In comments l are links, d is the
distance of two links' ends, r and h are the coordinates of the plane in which a finger bends, from the first joint that
bends; directions in that plane are counted from h towards r.
"""
