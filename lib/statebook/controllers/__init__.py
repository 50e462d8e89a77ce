"""Controllers: feedback laws, swing-up, and what a clock does to them."""

from statebook.controllers.clocked import simulate_clocked
from statebook.controllers.feedback import LQR, PD, PID
from statebook.controllers.open_loop import bang_bang
from statebook.controllers.swing_up import SwingUp

__all__ = ["LQR", "PD", "PID", "SwingUp", "bang_bang", "simulate_clocked"]
