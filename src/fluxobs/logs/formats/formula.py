"""Formulas in files: arithmetic of one value, and nothing else."""

from __future__ import annotations

import ast

#: Functions that ASAM's formulas and numexpr have in common.
FUNCTIONS = (
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh"),
    *("exp", "log", "log10", "sqrt", "abs"),
)
VALUES = ("X", "X1", "INF", "NaN")
#: Longest formula: a polynomial of degree ten, its coefficients with all their digits, has 300.
LENGTH = 1000
#: Largest exponent. numexpr writes a power as products, and a power in a power as products of
#: products: the work is bounded if there are none of these, and exponents are small.
EXPONENT = 16
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
    if len(formula) > LENGTH:
        return False
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
        case ast.BinOp(op=ast.Pow()):
            return _is_small_power(node)
        case _:
            return isinstance(node, _ARITHMETIC)


def _is_small_power(power: ast.BinOp) -> bool:
    """Whether it is a power of X, by a small number, of something without powers."""
    exponent = power.right
    if not isinstance(exponent, ast.Constant) or not isinstance(exponent.value, int | float):
        return False
    base = list(ast.walk(power.left))
    return (
        abs(exponent.value) <= EXPONENT
        and any(isinstance(one, ast.Name) and one.id in ("X", "X1") for one in base)
        and not any(isinstance(one, ast.Pow) for one in base)
    )
