"""Pictures of a sweep, a file for each kind."""

from rattlesweep.analysis.plots.choice import KINDS, MAPS, choose_picture, default_kind
from rattlesweep.analysis.plots.picture import Picture

__all__ = ["KINDS", "MAPS", "Picture", "choose_picture", "default_kind"]
