"""Controllers: feedback laws, swing-up, and what a clock does to them."""

from statebook.controllers.cart_pole import CartPoleSwingUp, cart_force
from statebook.controllers.clocked import simulate_clocked
from statebook.controllers.lqr import LQR
from statebook.controllers.open_loop import bang_bang
from statebook.controllers.pid import PD, PID
from statebook.controllers.swing_up import SwingUp

__all__ = [
    "LQR",
    "PD",
    "PID",
    "CartPoleSwingUp",
    "SwingUp",
    "bang_bang",
    "cart_force",
    "simulate_clocked",
]
