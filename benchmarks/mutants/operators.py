"""Mutation operators: small faults in the syntax tree of a module, as edits of its text.

Not generated, by rule: what leaves the syntax tree as it was; annotations, docstrings and other texts, messages of
`raise` and `assert`, `__all__`, decorators, patterns of `match`, imports, `if TYPE_CHECKING`, calls of a logger.
"""

import ast
import copy
import hashlib
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
SIGNS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
SILENT = {"debug", "info", "warning"}  # methods of a logger


class Mutant(NamedTuple):
    """One edit of one module."""

    operator: str
    start: int  # of what is replaced, in bytes of the source
    end: int
    line: int  # from 1
    last_line: int
    old: str
    new: str
    where: str  # the function or class around it; "" for the module
    at_import: bool  # runs when the module is imported, not when a function is called

    def applied(self, source: bytes) -> bytes:
        return source[: self.start] + self.new.encode() + source[self.end :]

    def identity(self, source: bytes) -> str:
        """The edit and the lines it is in, wherever they move."""
        first, last = source.rfind(b"\n", 0, self.start) + 1, source.find(b"\n", self.end)
        text = source[first:last]
        column = self.start - first - (len(text) - len(text.lstrip()))
        return "\0".join([self.operator, self.where, text.strip().decode(), str(column), self.new])


def keys_of(source: bytes, mutants: list[Mutant]) -> list[str]:
    """Short names of a module's mutants, which survive edits elsewhere in it."""
    seen: Counter[str] = Counter()
    keys = []
    for mutant in mutants:
        identity = mutant.identity(source)
        seen[identity] += 1
        keys.append(hashlib.sha256(f"{identity}\0{seen[identity]}".encode()).hexdigest()[:12])
    return keys


def mutants_of(source: bytes) -> list[Mutant]:
    """All mutants of a module, in the order of its text."""
    found: dict[tuple[int, int, str], Mutant] = {}
    for mutant in _Walk(source).visit_body(ast.parse(source).body, ""):
        if _tree(mutant.new) != _tree(mutant.old):
            found.setdefault((mutant.start, mutant.end, mutant.new), mutant)
    return sorted(found.values(), key=lambda mutant: (mutant.start, mutant.end, mutant.new))


def _tree(text: str) -> str:
    """The syntax tree of an expression; a statement as it is."""
    try:
        return ast.dump(ast.parse(f"({text})", mode="eval"))
    except SyntaxError:
        return text


class _Walk:
    """Walks statements and expressions; yields edits."""

    def __init__(self, source: bytes) -> None:
        self.source = source
        self.depth = 0  # functions around the statement
        self.lines = [0]
        for line in source.split(b"\n"):
            self.lines.append(self.lines[-1] + len(line) + 1)

    def edit(self, operator: str, node: Any, new: str, where: str) -> Mutant:
        start = self.lines[node.lineno - 1] + node.col_offset
        end = self.lines[node.end_lineno - 1] + node.end_col_offset
        old = self.source[start:end].decode()
        return Mutant(operator, start, end, node.lineno, node.end_lineno, old, new, where, self.depth == 0)

    def visit_body(self, body: list[ast.stmt], where: str) -> Iterator[Mutant]:
        for statement in body:
            yield from self.statement(statement, where)

    def statement(self, node: ast.stmt, where: str) -> Iterator[Mutant]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            inside = f"{where}.{node.name}".lstrip(".")
            if not isinstance(node, ast.ClassDef):
                for default in (*node.args.defaults, *filter(None, node.args.kw_defaults)):
                    yield from self.expression(default, inside)
            self.depth += not isinstance(node, ast.ClassDef)
            yield from self.visit_body(node.body, inside)
            self.depth -= not isinstance(node, ast.ClassDef)
            return
        if isinstance(node, ast.Import | ast.ImportFrom) or _is_excluded(node):
            return
        yield from self.dropped(node, where)
        for name, value in ast.iter_fields(node):
            for each in value if isinstance(value, list) else [value]:
                if isinstance(each, ast.stmt):
                    yield from self.statement(each, where)
                elif isinstance(each, ast.ExceptHandler | ast.match_case):
                    yield from self.visit_body(each.body, where)
                elif isinstance(each, ast.withitem):
                    yield from self.expression(each.context_expr, where)
                elif isinstance(each, ast.expr) and not _is_unchecked(node, name):
                    yield from self.expression(each, where)

    def dropped(self, node: ast.stmt, where: str) -> Iterator[Mutant]:
        """Statements that vanish, loops that end early, conditions that always or never hold."""
        if isinstance(node, ast.If):
            yield self.edit("returned early", node.test, "True", where)
            yield self.edit("dropped statement", node.test, "False", where)
            yield self.edit("negation", node.test, f"(not ({ast.unparse(node.test)}))", where)
        elif isinstance(node, ast.While) and not isinstance(node.test, ast.Constant):
            yield self.edit("dropped statement", node.test, "False", where)
        elif _has_effect(node):
            yield self.edit("dropped statement", node, "pass", where)
        elif isinstance(node, ast.Continue | ast.Break):
            yield self.edit("returned early", node, "break" if isinstance(node, ast.Continue) else "continue", where)
        elif isinstance(node, ast.Return) and node.value is not None and not _is_none(node.value):
            yield self.edit("returned early", node.value, "None", where)

    def expression(self, node: ast.expr, where: str, in_index: bool = False) -> Iterator[Mutant]:
        if isinstance(node, ast.JoinedStr) or _is_text(node) or _is_log(node):
            return
        for operator, new in self.replacements(node, in_index):
            yield self.edit(operator, node, f"({new})" if not new.isidentifier() else new, where)
        for name, value in ast.iter_fields(node):
            inside = in_index and not isinstance(node, ast.Call)
            for each in value if isinstance(value, list) else [value]:
                if isinstance(each, ast.keyword):
                    yield from self.expression(each.value, where)
                elif isinstance(each, ast.comprehension):
                    for part in (each.iter, *each.ifs):
                        yield from self.expression(part, where)
                elif isinstance(each, ast.expr):
                    is_index = isinstance(node, ast.Subscript) and name == "slice"
                    yield from self.expression(each, where, inside or is_index)

    def replacements(self, node: ast.expr, in_index: bool) -> Iterator[tuple[str, str]]:
        if isinstance(node, ast.Compare):
            for i, op in enumerate(node.ops):
                for other in COMPARISONS.get(type(op), ()):
                    new = copy.deepcopy(node)
                    new.ops[i] = other()
                    yield "comparison", ast.unparse(new)
        elif isinstance(node, ast.BinOp) and not _is_type(node) and not _is_text(node.left):
            if type(node.op) in SIGNS:
                yield "sign", ast.unparse(ast.BinOp(node.left, SIGNS[type(node.op)](), node.right))
            for kept in (node.left, node.right) if isinstance(node.op, ast.Add | ast.Sub | ast.Mult) else ():
                yield "dropped term", ast.unparse(kept)
        elif isinstance(node, ast.UnaryOp) and not isinstance(node.operand, ast.Constant):
            yield ("negation" if isinstance(node.op, ast.Not) else "sign"), ast.unparse(node.operand)
        elif isinstance(node, ast.BoolOp):
            other_op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield "negation", ast.unparse(ast.BoolOp(other_op, node.values))
            for i in range(len(node.values)):
                rest = [value for j, value in enumerate(node.values) if j != i]
                yield "dropped term", ast.unparse(ast.BoolOp(node.op, rest) if len(rest) > 1 else rest[0])
        elif isinstance(node, ast.IfExp):
            yield "negation", ast.unparse(ast.IfExp(node.test, node.orelse, node.body))
        elif isinstance(node, ast.Call):
            yield from _swapped(node)
        elif isinstance(node, ast.Constant):
            yield from _constants(node.value, in_index)


def _swapped(node: ast.Call) -> Iterator[tuple[str, str]]:
    """Neighbouring arguments exchanged, and min for max."""
    plain = [not isinstance(arg, ast.Starred) for arg in node.args]
    for i in range(len(node.args) - 1):
        if plain[i] and plain[i + 1] and ast.dump(node.args[i]) != ast.dump(node.args[i + 1]):
            new = copy.deepcopy(node)
            new.args[i], new.args[i + 1] = new.args[i + 1], new.args[i]
            if not (isinstance(node.func, ast.Name | ast.Attribute) and _name(node.func) in COMMUTATIVE):
                yield "swapped arguments", ast.unparse(new)
    other = EXCHANGED.get(_name(node.func))
    if other:
        new = copy.deepcopy(node)
        if isinstance(new.func, ast.Attribute):
            new.func.attr = other
        else:
            new.func = ast.Name(other)
        yield "swapped function", ast.unparse(new)


COMMUTATIVE = {
    *("min", "max", "minimum", "maximum", "dot", "hypot", "isinstance", "logical_and", "logical_or"),
    *("multiply", "intersect1d", "row_distance", "add", "component_min", "component_max"),
}
EXCHANGED = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any"}


def _constants(value: Any, in_index: bool) -> Iterator[tuple[str, str]]:
    kind = "index" if in_index else "constant"
    if value is True or value is False:
        yield kind, str(not value)
    elif isinstance(value, int):
        yield kind, str(value + 1)
        yield kind if in_index else "off by one", str(value - 1)
    elif isinstance(value, float):
        yield kind, repr(value / 2.0 if value else 1.0)


def _name(func: ast.expr) -> str:
    return func.id if isinstance(func, ast.Name) else func.attr if isinstance(func, ast.Attribute) else ""


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))


def _is_type(node: ast.BinOp) -> bool:
    """`int | None`: a union of types."""
    parts = (node.left, node.right)
    return isinstance(node.op, ast.BitOr) and any(_is_none(part) or _name(part)[:1].isupper() for part in parts)


def _is_log(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in SILENT


def _has_effect(node: ast.stmt) -> bool:
    """Whether something else than names that later statements need goes without the statement."""
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Call | ast.Yield | ast.YieldFrom)
    if isinstance(node, ast.Assign):
        return not isinstance(node.targets[0], ast.Name | ast.Tuple)
    return isinstance(node, ast.Raise | ast.AugAssign)


def _is_unchecked(node: ast.stmt, name: str) -> bool:
    """Whether an expression of a statement is an annotation or a message."""
    message = isinstance(node, ast.Raise) or (isinstance(node, ast.Assert) and name == "msg")
    return message or name == "annotation"


def _is_excluded(node: ast.stmt) -> bool:
    if isinstance(node, ast.Expr) and (_is_text(node.value) or _is_log(node.value)):
        return True
    if isinstance(node, ast.If) and _name(node.test) == "TYPE_CHECKING":
        return True
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return any(_name(target) == "__all__" for target in targets)
