"""The relation between flux and current, the linear system that it leads to, frames, inverter."""
