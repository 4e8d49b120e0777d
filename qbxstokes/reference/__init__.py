"""Closed forms and semi-analytic solutions; they share no code with what they verify."""
