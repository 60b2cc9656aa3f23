"""`make models`: write the descriptions, or with --check tell whether the committed ones are stale."""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path

from allegro_twin.files.assets import data_root
from allegro_twin.hands.description import arms, facts
from allegro_twin.hands.description.specs import load_actuation
from allegro_twin.hands.generate import mesh, tendon_mjcf
from allegro_twin.hands.generate.arm_mjcf import arm_mjcf
from allegro_twin.hands.generate.arm_urdf import arm_urdf
from allegro_twin.hands.generate.mjcf import mjcf
from allegro_twin.hands.generate.tendon_urdf import tendon_urdf
from allegro_twin.hands.generate.text import mesh_name
from allegro_twin.hands.generate.urdf import urdf
from allegro_twin.spec import SIDES


def files() -> dict[Path, str]:
    """All generated files of all hands and arms with a table of facts, by their paths under models/."""
    made: dict[Path, str] = {}
    for model, side in product(sorted(path.stem for path in (data_root() / "models").glob("*.yaml")), SIDES):
        hand = facts.load_facts(model, side)
        actuation = load_actuation(model, len(hand.joints))
        made[Path("mjcf") / f"{model}_{side}.xml"] = mjcf(hand, actuation)
        made[Path("urdf") / f"{model}_{side}.urdf"] = urdf(hand, actuation)
        for visual in (v for link in hand.links for v in link.visuals if v.kind == "rounded"):
            made[Path("meshes") / f"{mesh_name(visual)}.obj"] = mesh.obj(*mesh.rounded_box(visual.size, visual.radius))
    for path in tendon_mjcf.tables():
        text = tendon_mjcf.tendon_mjcf(path)
        made[Path("mjcf") / f"{path.stem}_right.xml"] = text
        made[Path("urdf") / f"{path.stem}_right.urdf"] = tendon_urdf(text)
    for model in arms.arm_names():
        arm, spec = arms.load_arm_facts(model), arms.load_arm_spec(model)
        made[Path("mjcf") / f"{model}.xml"] = arm_mjcf(arm, spec)
        made[Path("urdf") / f"{model}.urdf"] = arm_urdf(arm, spec)
    return made


def stale() -> list[str]:
    """Names of committed files that differ from what the facts give, or should not be there."""
    root, made = data_root() / "models", files()
    wrong = [
        str(path) for path, text in made.items() if not (root / path).is_file() or (root / path).read_text() != text
    ]
    present = {p.relative_to(root) for folder in ("mjcf", "urdf", "meshes") for p in (root / folder).iterdir()}
    return sorted(wrong + [str(path) for path in present - set(made)])


def main() -> int:
    if "--check" in sys.argv:
        wrong = stale()
        sys.stdout.write(f"stale, run `make models`: {', '.join(wrong)}\n" if wrong else "models are up to date\n")
        return 1 if wrong else 0
    root = data_root() / "models"
    for path, text in files().items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
        sys.stdout.write(f"models/{path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
