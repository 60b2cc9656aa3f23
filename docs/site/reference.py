"""Writes the generated reference: `python docs/site/reference.py` makes commands.md, configs.md and api/ anew."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import typer

import allegro_twin
from allegro_twin.files.schema import json_schema
from allegro_twin.surfaces.cli.data.schemas import PLACES, models
from allegro_twin.surfaces.cli.main import PANELS, app

PACKAGE = Path(allegro_twin.__file__).parent
REFERENCE = Path(__file__).resolve().parents[1] / "reference"
AGAIN = "Made by `make reference`; do not edit."
EXIT_CODES = """| exit code | |
|---|---|
| 0 | done |
| 2 | config, file, option or recording wrong; a file that cannot be written, even after a result that ends with 0 |
| 3 | the link to a hand failed |
| 4 | a fault, or a blocked motion |
| 5 | a grasp that does not hold, a posture that is not reached, an object that is missed |
| 130 | interrupted; by another signal than that of Ctrl-C, 128 and its number: 143 by SIGTERM |
"""


def commands() -> str:
    """The page of all commands with their arguments and options."""
    root: Any = typer.main.get_command(app)
    parts = [
        "# Commands",
        f"*Reference: every command of `allegro-twin`, with arguments and options. {AGAIN}*",
        "`allegro-twin COMMAND --help` prints the same. Every error is one line.",
        EXIT_CODES.rstrip(),
    ]
    for panel in PANELS:
        parts.append(f"## {panel}")
        for name, command in root.commands.items():
            if command.rich_help_panel == panel:
                parts += list(_command(f"allegro-twin {name}", command))
    return "\n\n".join(parts) + "\n"


def _command(path: str, command: Any) -> Iterator[str]:
    if hasattr(command, "commands"):
        for name, each in command.commands.items():
            yield from _command(f"{path} {name}", each)
        return
    arguments = [each for each in command.params if each.param_type_name == "argument"]
    usage = " ".join([path, *(_usage(each) for each in arguments)])
    yield f"### `{usage}`"
    yield re.sub(r"\s*\n\s*\n\s*", "\n\n", re.sub(r"(?<!\n)\n(?!\n)\s*", " ", command.help.strip()))
    rows = [*(_row(each) for each in arguments), *(_row(each) for each in command.params if each not in arguments)]
    if rows:
        yield "| | | default |\n|---|---|---|\n" + "\n".join(rows)


def _usage(argument: Any) -> str:
    name = str(argument.metavar or argument.name).strip("[]").upper()
    name += "…" if argument.nargs == -1 else ""
    return name if argument.required else f"[{name}]"


def _row(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        name = f"`{_usage(parameter)}`"
    else:
        name = ", ".join(f"`{each}`" for each in [*parameter.opts, *parameter.secondary_opts])
    default = parameter.default
    shown = "" if default is None or callable(default) or isinstance(default, (bool, list, tuple)) else str(default)
    shown = getattr(default, "value", shown) if shown else shown
    return f"| {name} | {_cell(parameter.help)} | {f'`{shown}`' if shown else ''} |"


def configs() -> str:
    """The page of all keys of the YAML files."""
    parts = [
        "# Keys of the YAML files",
        f"*Reference: every key, with its type, range and default. {AGAIN}* The JSON Schemas of `allegro-twin schemas` "
        "have the same, for an editor.",
    ]
    for kind, model in models().items():
        schema = json_schema(model, kind)
        whole = schema.get("else", schema)
        parts.append(f'<a id="{kind}"></a>\n## {kind.capitalize()} (`{PLACES[kind]}`)')
        parts.append(_table(whole, schema["properties"]))
        for name, part in sorted(schema.get("$defs", {}).items()):
            if part.get("properties"):
                parts.append(f"### {kind}: {_title(name)}")
                parts.append(_cell(part.get("description", "")))
                parts.append(_table(part, part["properties"]))
    return "\n\n".join(filter(None, parts)) + "\n"


def _table(part: dict[str, Any], texts: dict[str, Any]) -> str:
    rows = []
    for key, content in part.get("properties", {}).items():
        text = content.get("description") or texts.get(key, {}).get("description", "")
        default = content.get("default", "")
        shown = "" if default in ("", None) else f"`{json.dumps(default, ensure_ascii=False)}`"
        needed = "needed" if key in part.get("required", ()) else shown
        rows.append(f"| `{key}` | {_type(content)} | {_cell(text)} | {needed} |")
    return "| key | type | | default |\n|---|---|---|---|\n" + "\n".join(rows)


def _type(content: dict[str, Any]) -> str:
    if "$ref" in content:
        return _title(content["$ref"].rsplit("/", 1)[1])
    for key in ("anyOf", "oneOf"):
        if key in content:
            return " or ".join(dict.fromkeys(_type(each) for each in content[key]))
    if "enum" in content:
        return ", ".join(f"`{each}`" for each in content["enum"])
    if "const" in content:
        return f"`{content['const']}`"
    kind = str(content.get("type", "any"))
    bounds = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    limits = ", ".join(f"{sign} {content[key]:g}" for key, sign in bounds.items() if key in content)
    if kind == "array" and "items" in content and content["items"]:
        kind = f"list of {_type(content['items'])}"
    return f"{kind} {limits}".strip()


def _title(name: str) -> str:
    """`CanSettings` as `can`."""
    words = re.findall(r"[A-Z][a-z0-9]*|[A-Z]+(?![a-z])", name.removesuffix("Settings").removesuffix("File"))
    return " ".join(words).lower() or name


def _cell(text: str | None) -> str:
    return " ".join((text or "").split()).replace("|", "\\|")


CONTRACT = ("backend", "controller", "device", "errors", "loop", "plugins", "safety", "types")
"""Modules at the top of the package: every name in them without an underscore is public."""


def packages() -> dict[str, list[str]]:
    """The public names of the package, of its contract's modules and of its wings."""
    found = {"allegro_twin": sorted(allegro_twin.__all__)}
    for name in CONTRACT:
        found[f"allegro_twin.{name}"] = _defined(PACKAGE / f"{name}.py")
    found["allegro_twin.gym"] = sorted(import_module("allegro_twin.gym").__all__)
    for path in sorted(PACKAGE.rglob("__init__.py")):
        parts = path.parent.relative_to(PACKAGE).parts
        if parts and "__all__ = " in path.read_text():
            package = ".".join(("allegro_twin", *parts))
            found[package] = sorted(import_module(package).__all__)
    return found


def _defined(path: Path) -> list[str]:
    """The names that a module defines, but for private ones."""
    names = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.AnnAssign | ast.Assign):
            targets = [node.target] if isinstance(node, ast.AnnAssign) else node.targets
            names |= {each.id for each in targets if isinstance(each, ast.Name)}
    return sorted(name for name in names if not name.startswith("_"))


def api() -> dict[str, str]:
    """The pages of the public names, by file name."""
    pages = {}
    rows = []
    for package, names in packages().items():
        file = f"{package.removeprefix('allegro_twin.')}.md"
        shown = [name for name in names if not name.startswith("__")]
        rows.append(f"| [`{package}`]({file}) | {', '.join(f'`{name}`' for name in shown)} |")
        entries = "\n".join(f"::: {package}.{name}" for name in shown)
        listed = ", ".join(f"`{name}`" for name in shown)
        pages[file] = f"# `{package}`\n\n*Reference: public names. {AGAIN}* {listed}.\n\n{entries}\n"
    head = f"""# Python API

*Reference: every public name. {AGAIN}* Import names from these packages, such as `from allegro_twin import Hand`.
Everything below them is private and may move. The entries of these pages are made from the docstrings (`make docs`).

| package | public names |
|---|---|
"""
    return pages | {"index.md": head + "\n".join(rows) + "\n"}


def main() -> None:
    """Write the pages; those of packages without public names go."""
    (REFERENCE / "commands.md").write_text(commands())
    (REFERENCE / "configs.md").write_text(configs())
    folder = REFERENCE / "api"
    folder.mkdir(exist_ok=True)
    pages = api()
    for path in folder.glob("*.md"):
        if path.name not in pages:
            path.unlink()
    for name, text in pages.items():
        (folder / name).write_text(text)


if __name__ == "__main__":
    main()
