"""What if: a recording goes on otherwise from some instant, beside what was.

A simulation is run again from its beginning (`repeated`); the future of a hand on a wire is that of its model, from
what a mirror knows of it at that instant (`estimated`).
"""

from allegro_twin.twin.branch.branch import branch, by_model
from allegro_twin.twin.branch.overrides import changes_of
from allegro_twin.twin.branch.result import Beside, Branched, Wanted

__all__ = ["Beside", "Branched", "Wanted", "branch", "by_model", "changes_of"]
