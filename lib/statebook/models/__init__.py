"""The workbook's physical systems, one frozen dataclass each.

States are positions, then velocities. Angles are counter-clockwise from the +x axis:
a pendulum hangs at -pi/2 and stands at +pi/2. Units are SI. Every ``dynamics(x, u)``
takes one state (n,) or a batch (n, N), real or complex.
"""
