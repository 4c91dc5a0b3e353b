"""Formulas in files: only arithmetic with one variable is allowed."""

from __future__ import annotations

import ast

#: Functions that ASAM's formulas and numexpr have in common.
FUNCTIONS = (
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh"),
    *("exp", "log", "log10", "sqrt", "abs"),
)
VALUES = ("X", "X1", "INF", "NaN")
#: Longest formula [characters]. A polynomial of degree ten with coefficients of full precision has
#: 300 characters.
LENGTH = 1000
#: Largest exponent. numexpr expands a power into products, and nested powers into products of
#: products. The work is bounded because powers are not nested and exponents are small.
EXPONENT = 16
_ARITHMETIC = (
    *(ast.Expression, ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Load, ast.Constant),
    *(ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Mod, ast.Pow, ast.UAdd, ast.USub),
)


def is_arithmetic(formula: str) -> bool:
    """Return whether a formula only computes a number, in a time independent of its constants.

    Libraries pass formulas to an interpreter, which would run any code in a formula.

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
    return all(_is_allowed(node, id(node) in functions) for node in nodes)


def _is_allowed(node: ast.AST, called: bool) -> bool:
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
    """Return whether a power has a small constant exponent, and a base with X but no powers."""
    exponent = power.right
    if not isinstance(exponent, ast.Constant) or not isinstance(exponent.value, int | float):
        return False
    base = list(ast.walk(power.left))
    return (
        abs(exponent.value) <= EXPONENT
        and any(isinstance(node, ast.Name) and node.id in ("X", "X1") for node in base)
        and not any(isinstance(node, ast.Pow) for node in base)
    )
