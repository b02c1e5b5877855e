"""The text of kernels from equations in symbols. For development only."""

import ast
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter


class _Printer(PythonCodePrinter):  # type: ignore[misc]
    """Small powers as products, square roots as sqrt."""

    def _print_Pow(self, expr: Any, rational: bool = False) -> str:
        base, power = expr.as_base_exp()
        if power.is_Integer and 2 <= abs(power) <= 4:
            product = "*".join([self.parenthesize(base, 60)] * abs(int(power)))
            return f"({product})" if power > 0 else f"(1.0/({product}))"
        if power == -1:
            return f"(1.0/{self.parenthesize(base, 60)})"
        return str(super()._print_Pow(expr, rational=rational))

    def _print_Rational(self, expr: Any) -> str:
        return repr(float(expr))


def text(expression: Any) -> str:
    """Of an expression, in Python."""
    return str(
        _Printer({"fully_qualified_modules": False, "allow_unknown_functions": True}).doprint(expression)
    )


def kernel(
    name: str, about: str, parameters: str, lines: Iterable[str], kind: str = "kernel", gives: str = "None"
) -> str:
    """Of a kernel with these lines. kind: of its decorator."""
    head = [f"@{kind}", f"def {name}({parameters}) -> {gives}:", f'    """{about}"""']
    return "\n".join([*head, *_once(lines)]) + "\n"


def _once(lines: Iterable[str]) -> Iterator[str]:
    """The same lines, where what occurs twice is computed once: equal to the last bit, and sooner compiled.

    Each name is given a value once, before it is read.
    """
    statements = [ast.parse(line.strip()).body[0] for line in lines]
    values = [one.value for one in statements if isinstance(one, (ast.Assign, ast.Return)) and one.value]
    uses: Counter[str] = Counter()  # of an operation, as text: in how many different places it stands
    seen: set[str] = set()
    for value in values:
        uses[ast.unparse(value)] += 1
        for within in ast.walk(value):
            if (whole := ast.unparse(within)) not in seen:
                seen.add(whole)
                uses.update(ast.unparse(part) for part in ast.iter_child_nodes(within))
    names: dict[str, str] = {}
    new: list[str] = []

    class Named(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> ast.AST:
            written = ast.unparse(node)
            if not isinstance(node, (ast.BinOp, ast.Call)) or uses[written] < 2:
                return super().generic_visit(node)
            if written not in names:
                computed = ast.unparse(self.generic_visit(node))  # what is within it gets its names first
                names[written] = f"c{len(names)}"
                new.append(f"    {names[written]} = {computed}")
            return ast.Name(names[written])

    for statement in statements:
        line = ast.unparse(Named().visit(statement))
        yield from new
        new.clear()
        yield f"    {line}"


def readings(given: dict[str, str], steps: Iterable[Any]) -> list[str]:
    """Lines that read what the expressions need. given: symbol -> where it is read."""
    used = {str(symbol) for step in steps for symbol in step.free_symbols}
    return [f"    {symbol} = {where}" for symbol, where in given.items() if symbol in used - {where}]


def value_lines(given: dict[str, str], outputs: dict[str, Any]) -> list[str]:
    """Lines that compute the outputs: target -> expression; 0 is left out."""
    wanted = {target: expression for target, expression in outputs.items() if expression != 0}
    shared, reduced = sp.cse(list(wanted.values()), symbols=sp.numbered_symbols("t"))
    lines = readings(given, [*(e for _, e in shared), *reduced])
    lines += [f"    {symbol} = {text(expression)}" for symbol, expression in shared]
    return lines + [f"    {target} = {text(e)}" for target, e in zip(wanted, reduced, strict=True)]


def slope_lines(given: dict[str, str], outputs: dict[str, Any], columns: list[Any]) -> list[str]:
    """Lines that compute the derivatives of the outputs (row of an array -> expression) by the columns.

    Forward differentiation of the steps that give the values: each step's derivatives by what it is made of,
    times the derivatives of these by the columns.
    """
    shared, reduced = sp.cse(list(outputs.values()), symbols=sp.numbered_symbols("t"))
    slopes: dict[Any, dict[int, Any]] = {q: {j: sp.Integer(1)} for j, q in enumerate(columns)}
    lines: list[str] = []
    partials = sp.numbered_symbols("s")
    products = sp.numbered_symbols("d")

    def named(expression: Any, names: Any) -> Any:
        if expression.is_Number or expression.is_Symbol or (-expression).is_Symbol:
            return expression
        symbol = next(names)
        lines.append(f"    {symbol} = {text(expression)}")
        return symbol

    def by_columns(expression: Any) -> dict[int, Any]:
        total: dict[int, Any] = {}
        for part in sorted(expression.free_symbols & slopes.keys(), key=str):
            partial = named(sp.diff(expression, part), partials)
            for j, slope in slopes[part].items():
                total[j] = total.get(j, 0) + partial * slope
        return {j: slope for j, slope in total.items() if slope != 0}

    read = readings(given, [*(e for _, e in shared), *reduced])
    for symbol, expression in shared:
        lines.append(f"    {symbol} = {text(expression)}")
        found = by_columns(expression)
        if found:
            slopes[symbol] = {j: named(slope, products) for j, slope in found.items()}
    for row, expression in zip(outputs, reduced, strict=True):
        lines += [f"    {row[:-1]}, {j}] = {text(slope)}" for j, slope in by_columns(expression).items()]
    return read + lines
