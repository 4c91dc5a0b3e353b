"""Formulas in files: arithmetic of one value, and nothing else."""

from __future__ import annotations

import ast

#: Functions that ASAM's formulas and numexpr have in common.
FUNCTIONS = (
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh"),
    *("exp", "log", "log10", "sqrt", "abs"),
)
VALUES = ("X", "X1", "INF", "NaN")
_ARITHMETIC = (
    *(ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Load, ast.Constant),
    *(ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Mod, ast.Pow, ast.UAdd, ast.USub),
)


def is_arithmetic(formula: str) -> bool:
    """Whether a formula can only compute a number, in a time that does not depend on its numbers.

    Libraries hand the formulas of a file to an interpreter, which would run any code in them.

    Examples
    --------
    >>> is_arithmetic("0.5 * X1 + sqrt(X1**2 + 1)"), is_arithmetic("__import__('os')")
    (True, False)
    """
    try:
        nodes = list(ast.walk(ast.parse(formula.strip(), mode="eval")))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return False
    functions = {id(node.func) for node in nodes if isinstance(node, ast.Call)}
    return all(_allowed(node, id(node) in functions) for node in nodes)


def _allowed(node: ast.AST, called: bool) -> bool:
    match node:
        case ast.Name():
            return node.id in (FUNCTIONS if called else VALUES)
        case ast.Constant():
            return type(node.value) in (int, float)
        case ast.Call():
            return isinstance(node.func, ast.Name) and not node.keywords
        case ast.BinOp(op=ast.Pow()):  # 9**9**9 would compute for hours
            return isinstance(node.right, ast.Constant) and any(
                isinstance(one, ast.Name) and one.id in ("X", "X1") for one in ast.walk(node.left)
            )
        case _:
            return isinstance(node, _ARITHMETIC)
