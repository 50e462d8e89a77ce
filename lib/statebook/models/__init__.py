"""The workbook's physical systems, one frozen dataclass each.

States are positions, then velocities. Angles are counter-clockwise from the +x axis:
a pendulum hangs at -pi/2 and stands at +pi/2. Units are SI. Every ``dynamics(x, u)``
takes one state (n,) or a batch (n, N), real or complex.
"""

from statebook.models.car import DubinsCar
from statebook.models.cart_pole import CartPole
from statebook.models.oscillator import Oscillator
from statebook.models.particle import Particle
from statebook.models.pendulum import Pendulum
from statebook.models.planar_arm import PlanarArm

__all__ = ["CartPole", "DubinsCar", "Oscillator", "Particle", "Pendulum", "PlanarArm"]
