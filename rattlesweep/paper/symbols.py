"""The paper's symbols in HTML, from their plain spelling: ``omega_xy0``, ``abs(n_i)``, ``->``."""

from __future__ import annotations

import re
from html import escape

from markupsafe import Markup

GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "theta": "θ", "phi": "φ", "xi": "ξ",
    "omega": "ω", "psi": "ψ", "delta": "δ", "epsilon": "ε",
}  # fmt: skip
SIGNS = {
    "-&gt;": "→",
    "&lt;=": "≤",
    "&gt;=": "≥",
    "&lt;~": "≲",
    "&gt;~": "≳",
    "&lt;&lt;": "≪",
    "&gt;&gt;": "≫",
    " ~ ": " ≈ ",
    " +- ": " ± ",
    "omega~": "ω̃",
    "t~": "t̃",
    "^deg": "°",
    "F_perp": "F_⊥",
    "F_parallel": "F_∥",
}
_ABSOLUTE = re.compile(r"\babs\(([^()]*)\)")
# A file's name is no symbol.
_INDEXED = re.compile(
    r"(?<![\w.])(omega|psi|delta|[CEFIJKnut])_(rGH[+-]|[⊥∥]|(?:rGH|I|[a-z]+\d?|\d)\b)(?![.]?\w)"
)
_LETTER = re.compile(r"(?<![\w.-])(" + "|".join(GREEK) + r")(?![\w.])")
_POWER = re.compile(r"\^([+-]?\d+(?:/\d+)?)")
_SIZE = re.compile(r"(?<![\w|])omega_xy0\b")


def symbols(text: str) -> Markup:
    """Escaped text with its symbols set as such."""
    text = escape(text, quote=False)
    for plain, sign in SIGNS.items():
        text = text.replace(plain, sign)
    text = _ABSOLUTE.sub(r"|\1|", text)
    text = _SIZE.sub("|ω<sub>xy0</sub>|", text)
    text = _INDEXED.sub(lambda m: f"<i>{GREEK.get(m[1], m[1])}</i><sub>{m[2]}</sub>", text)
    text = _LETTER.sub(lambda m: f"<i>{GREEK[m[1]]}</i>", text)
    return Markup(_POWER.sub(r"<sup>\1</sup>", text))
