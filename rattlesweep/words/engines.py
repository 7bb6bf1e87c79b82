"""The physics engines in which a run can be repeated: what is known of each."""

from collections.abc import Mapping
from dataclasses import dataclass

FACETS = (
    "The engine has no ellipsoid: its body is the convex hull of points, whose facets "
    "cost energy, so that finer steps do not lead to the exact time."
)
OWN_CONTACT = (
    "The engine has no contact of an ellipsoid with a plane: the file adds a stiff one."
)

COMPILES = (
    "Genesis needs PyTorch. Its first run compiles kernels, which took 90 s of the "
    "processor here; they are kept for later runs."
)


@dataclass(frozen=True)
class PhysicsEngine:
    """A physics engine: what its files need, and what it cannot have."""

    title: str
    installs: str  # what pip installs
    # The longest step of its file, in sqrt(a/g).
    step: float
    reads_mjcf: bool = False
    pivots: bool = False
    # A remark for who runs the file.
    remark: str = ""


ENGINES: Mapping[str, PhysicsEngine] = {
    "mujoco": PhysicsEngine("MuJoCo", "mujoco", 0.01, reads_mjcf=True, pivots=True),
    "mjx": PhysicsEngine("MJX", "mujoco-mjx", 0.01, reads_mjcf=True, pivots=True),
    "newton": PhysicsEngine("Newton", "newton", 0.01, pivots=True),
    "drake": PhysicsEngine("Drake", "drake", 0.01),
    "dart": PhysicsEngine("DART", "dartpy", 0.01),
    "genesis": PhysicsEngine(
        "Genesis", "genesis-world", 0.01, reads_mjcf=True, pivots=True, remark=COMPILES
    ),
    "motrix": PhysicsEngine("MotrixSim", "motrixsim", 0.01, reads_mjcf=True),
    "bullet": PhysicsEngine("Bullet", "pybullet", 0.005, pivots=True, remark=FACETS),
    "rapier": PhysicsEngine("Rapier", "rapier3d", 0.01, remark=FACETS),
    "exudyn": PhysicsEngine("Exudyn", "exudyn", 0.005, remark=OWN_CONTACT),
}
"""The engines by name; the adapter of each is the module of its name in
`analysis.engines.adapters`."""
