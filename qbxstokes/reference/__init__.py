"""Closed forms and semi-analytic solutions; they share no code with what they verify.

lamb: drag; jeffery: torque, free rotation and orbits in linear flow; chwang: paraboloidal flow;
faxen: free motion, force and torque in any flow; inertial: bodies with inertia.
"""
