"""Every small error that may be put into a file of the package.

A mutant changes one thing: a comparison, an operator of arithmetic or logic, a number, a condition, the way out of a
loop, or what is returned. Text, annotations and decorators are left alone, and so is what says nothing about what the
package does; a rule decides from the syntax alone (`_idle`):

- `strict=` of zip: the lengths are equal wherever the program is right.
- `slots=`, `frozen=`, `eq=`, `kw_only=`, `repr=` of a declaration, given as a constant; so the next four.
- `exist_ok=`, `parents=`, `missing_ok=` of a folder or file.
- `timeout=` and `daemon=` of a thread, a lock or a socket, and what `time.sleep` is given: patience.
- `maxsize=` of a cache or a queue and the bytes that `recv` asks for at most.
- `indent=` of JSON and the second argument of `round` inside text: digits for the eye.
- A `__repr__`; what stands under TYPE_CHECKING, in a Protocol or under `if __name__ == "__main__"`.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "allegro_twin"

_COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift,
    ast.RShift: ast.LShift, ast.BitXor: ast.BitAnd, ast.MatMult: ast.Add,
}  # fmt: skip
_IDLE_KEYWORDS = {"slots", "frozen", "eq", "kw_only", "repr", "exist_ok", "parents", "missing_ok", "timeout", "daemon",
                  "maxsize", "indent"}  # fmt: skip
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


@dataclass(frozen=True)
class Mutant:
    """One change: the file, the line, and the text that stands for a part of that file (offsets in characters).

    `lines` are those that use it: its own, or where a parameter's default is changed those of the function, or none
    where something is computed when the module is imported, which `names` says then."""

    path: Path
    line: int
    begin: int
    end: int
    text: str
    was: str
    lines: tuple[int, int] | None = None
    names: tuple[str, ...] = ()
    imported: bool = False

    def __str__(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}  {self.was}  →  {self.text}"

    @property
    def name(self) -> str:
        return str(self.path.relative_to(ROOT))

    @property
    def wing(self) -> str:
        return self.path.relative_to(PACKAGE).parts[0].removesuffix(".py")

    @property
    def key(self) -> str:
        """What tells it from every other mutant of the same sources."""
        return f"{self.name}:{self.line}:{self.begin}-{self.end}:{self.was}:{self.text}"

    def applied(self) -> str:
        source = self.path.read_text()
        return source[: self.begin] + self.text + source[self.end :]


class _Finder:
    """All mutants of a file."""

    def __init__(self, path: Path) -> None:
        self.path, self.source = path, path.read_text()
        self.found: list[Mutant] = []
        lines = self.source.splitlines(keepends=True)
        self._starts = [0]
        for line in lines:
            self._starts.append(self._starts[-1] + len(line))
        self._lines = [line.encode() for line in lines]
        self._inside = 0
        """How many functions the place stands in."""
        self._uses: tuple[int, int] | None = None
        self._names: tuple[str, ...] = ()
        self._visit(ast.parse(self.source))

    def _at(self, line: int, column: int) -> int:
        """An offset in characters of a place that ast gives in bytes of its line."""
        return self._starts[line - 1] + len(self._lines[line - 1][:column].decode())

    def _replace(self, node: ast.expr | ast.stmt, text: str) -> None:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        begin, end = self._at(node.lineno, node.col_offset), self._at(node.end_lineno, node.end_col_offset)
        lines = (node.lineno, node.end_lineno) if self._inside else self._uses
        was, imported = self.source[begin:end], not self._inside
        self.found.append(Mutant(self.path, node.lineno, begin, end, text, was, lines, self._names, imported))

    def _visit(self, node: ast.AST) -> None:
        if _idle(node):
            return
        self._look(node)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "zip":
            for argument in node.args:
                self._visit(argument)
            return
        if isinstance(node, _FUNCTIONS):
            self._function(node)
            return
        names = self._names
        if not self._inside and isinstance(node, ast.Assign | ast.AnnAssign | ast.ClassDef):
            self._names = (*((*names,) if isinstance(node, ast.ClassDef) else ()), *_named(node))
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list", "type_params", "bases"):
                continue
            if isinstance(node, ast.ClassDef) and field == "keywords":
                continue
            for each in value if isinstance(value, list) else [value]:
                if isinstance(each, ast.AST):
                    self._visit(each)
        self._names = names

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) -> None:
        body = node.body if isinstance(node.body, list) else [node.body]
        uses, self._uses = self._uses, (body[0].lineno, node.end_lineno or body[-1].lineno)
        for default in (*node.args.defaults, *(one for one in node.args.kw_defaults if one is not None)):
            self._visit(default)
        self._inside += 1
        for each in body:
            self._visit(each)
        self._inside -= 1
        self._uses = uses

    def _look(self, node: ast.AST) -> None:
        match node:
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARISONS:
                self._replace(node, ast.unparse(ast.Compare(left, [_COMPARISONS[type(op)]()], [right])))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS and not _textual(node):
                self._replace(node, f"({ast.unparse(ast.BinOp(left, _OPERATORS[type(op)](), right))})")
            case ast.BoolOp(op=op, values=values):
                other = ast.And() if isinstance(op, ast.Or) else ast.Or()
                self._replace(node, f"({ast.unparse(ast.BoolOp(other, values))})")
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                self._replace(node, f"bool({ast.unparse(operand)})")
            case ast.UnaryOp(op=ast.USub(), operand=operand) if not isinstance(operand, ast.Constant):
                self._replace(node, f"(+{ast.unparse(operand)})")
            case ast.Constant(value=bool(value)):
                self._replace(node, str(not value))
            case ast.Constant(value=int(value)):
                self._replace(node, str(value + 1))
            case ast.Constant(value=float(value)):
                self._replace(node, repr(value * 2.0 if value else 1.0))
            case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test) if not isinstance(test, ast.Compare):
                self._replace(test, f"(not ({ast.unparse(test)}))")
            case ast.Break():
                self._replace(node, "continue")
            case ast.Continue():
                self._replace(node, "break")
            case ast.Return(value=ast.expr() as value) if not _nothing(value):
                self._replace(value, "None")
            case ast.AugAssign(target=target, op=op, value=value) if type(op) in _OPERATORS and not _textual(value):
                other_op = _OPERATORS[type(op)]()
                self._replace(node, ast.unparse(ast.AugAssign(target, other_op, value)))


def _idle(node: ast.AST) -> bool:
    """Whether nothing below a node says what the package does: the rules above."""
    match node:
        case ast.keyword(arg=str(name), value=ast.Constant()):
            return name in _IDLE_KEYWORDS
        case ast.Call(func=ast.Attribute(value=ast.Name(id="time"), attr="sleep")):
            return True
        case ast.Call(func=ast.Attribute(attr="recv" | "recv_into"), args=[ast.Constant()]):
            return True
        case ast.FunctionDef(name="__repr__"):
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING") | ast.Compare(left=ast.Name(id="__name__"))):
            return True
        case ast.ClassDef(bases=bases):
            return any(isinstance(base, ast.Name) and base.id == "Protocol" for base in bases)
        case ast.FormattedValue(value=ast.Call(func=ast.Name(id="round"), args=[_, ast.Constant()])):
            return True
    return False


def _named(node: ast.AST) -> tuple[str, ...]:
    """What an assignment outside of functions or a class is called."""
    match node:
        case ast.ClassDef(name=name):
            return (name,)
        case ast.Assign(targets=targets):
            return tuple(each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name))
        case ast.AnnAssign(target=ast.Name(id=name)):
            return (name,)
    return ()


def _textual(node: ast.AST) -> bool:
    """Whether text, a path or a union of types is put together."""
    return any(
        isinstance(each, ast.JoinedStr) or (isinstance(each, ast.Constant) and not isinstance(each.value, int | float))
        for each in ast.walk(node)
    )


def _nothing(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def found_in(path: Path) -> list[Mutant]:
    """Every mutant of a file, in the order of places."""
    return sorted(_Finder(path).found, key=lambda one: (one.begin, one.end))


def mutants() -> list[Mutant]:
    """Every mutant of the package, in the order of files and places."""
    return [mutant for path in sorted(PACKAGE.rglob("*.py")) for mutant in found_in(path)]
