"""The body and the plane of a case as MJCF, which several engines read."""

import math


def model(case, step, joint="<freejoint/>", plane="0 0 .1"):
    """Return the body and the plane as MJCF."""
    numbers = {
        name: " ".join(map(repr, case[name]))
        for name in ("position", "quaternion", "inertia", "semi_axes", "centre")
    }
    half = case["angle"] / 2
    condim = 4 if case["lever"] else 3
    contact = (
        f'condim="{condim}" friction="{case["friction"]} {case["lever"]} 0" '
        f'solref="{2 * step} 1" solimp="0.9999 0.9999 0.001 0.5 2"'
    )
    return f"""<mujoco>
  <option timestep="{step}" gravity="0 0 {-case["gravity"]}" cone="elliptic"
    integrator="implicitfast" solver="Newton" iterations="100" tolerance="1e-12"/>
  <worldbody>
    <geom name="plane" type="plane" size="{plane}" {contact}/>
    <body name="rattleback" pos="{numbers["position"]}" quat="{numbers["quaternion"]}">
      {joint}
      <inertial pos="0 0 0" mass="{case["mass"]}" diaginertia="{numbers["inertia"]}"/>
      <geom name="surface" type="ellipsoid" size="{numbers["semi_axes"]}"
        pos="{numbers["centre"]}" quat="{math.cos(half)} 0 0 {math.sin(half)}"
        {contact}/>
    </body>
  </worldbody>
</mujoco>"""
