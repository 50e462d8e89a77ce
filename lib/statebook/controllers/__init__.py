"""Controllers: feedback laws, swing-up, and plans made in advance."""

from statebook.controllers.lqr import LQR
from statebook.controllers.open_loop import bang_bang
from statebook.controllers.pid import PD, PID
from statebook.controllers.swing_up import CartPoleSwingUp, SwingUp, cart_force

__all__ = ["LQR", "PD", "PID", "CartPoleSwingUp", "SwingUp", "bang_bang", "cart_force"]
