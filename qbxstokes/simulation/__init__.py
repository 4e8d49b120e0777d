"""The public door: bodies, flow, loads and integrator put together, without files."""
