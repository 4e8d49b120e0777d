"""The table of a sweep: what it says of each trajectory.

Apart from the integration, so that a dry run needs no PETSc, which all ranks would have to start.
"""

from __future__ import annotations

# Columns of the table after the swept values: name -> (units, description).
SUMMARY: dict[str, tuple[str, str]] = {
    "period": ("tau", "twice the mean time of a half-turn of the axis"),
    "period_change": ("1", "period over the later half of the half-turns minus earlier, relative"),
    "half_turns": ("1", "whole half-turns of the axis that averages are taken over"),
    "rotation_rate": ("1/tau", "mean rate of the axis about the vorticity's direction"),
    "mean_velocity_1": ("c/tau", "mean velocity over whole half-turns"),
    "mean_velocity_2": ("c/tau", "mean velocity over whole half-turns"),
    "mean_velocity_3": ("c/tau", "mean velocity over whole half-turns"),
    "velocity_change_1": ("c/tau", "mean velocity over the later half-turns minus the earlier"),
    "velocity_change_2": ("c/tau", "mean velocity over the later half-turns minus the earlier"),
    "velocity_change_3": ("c/tau", "mean velocity over the later half-turns minus the earlier"),
    "orbit_constant_start": ("1", "orbit constant in the local shear at the first sample"),
    "orbit_constant_end": ("1", "orbit constant in the local shear at the last sample"),
    "orbit_drift": ("1/tau", "mean rate of the logarithm of the orbit constant"),
    "jeffery_period": ("tau", "Jeffery's period in the gradient at the start"),
    "end": ("tau", "last instant"),
    "final_position_1": ("c", "position at the end"),
    "final_position_2": ("c", "position at the end"),
    "final_position_3": ("c", "position at the end"),
    "final_orientation_0": ("1", "orientation quaternion at the end"),
    "final_orientation_1": ("1", "orientation quaternion at the end"),
    "final_orientation_2": ("1", "orientation quaternion at the end"),
    "final_orientation_3": ("1", "orientation quaternion at the end"),
    "final_velocity_1": ("c/tau", "velocity at the end"),
    "final_velocity_2": ("c/tau", "velocity at the end"),
    "final_velocity_3": ("c/tau", "velocity at the end"),
    "final_angular_velocity_1": ("1/tau", "angular velocity at the end, in space"),
    "final_angular_velocity_2": ("1/tau", "angular velocity at the end, in space"),
    "final_angular_velocity_3": ("1/tau", "angular velocity at the end, in space"),
    "steps": ("1", "steps of its block"),
    "rhs_evaluations": ("1", "right-hand sides of its block, each for every trajectory in it"),
    "error_estimate": ("1", "error accepted in the integration, and the body model's over time"),
    "wall_time": ("s", "wall time of its block over the number of trajectories in it"),
}
