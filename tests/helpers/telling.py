"""How far something is, told to a test."""


def quiet(share: float, words: str) -> None:
    """What is told makes sense."""
    assert 0 <= share <= 1 + 1e-12
    assert words
