"""Pictures of a sweep, a file for each kind."""

from rattlesweep.analysis.plots.choice import (
    FIGURE_KINDS,
    MAPS,
    choose_picture,
    default_kind,
)
from rattlesweep.analysis.plots.picture import Picture

__all__ = ["FIGURE_KINDS", "MAPS", "Picture", "choose_picture", "default_kind"]
