"""The relation between flux and current, the linear system it leads to, frames, inverter."""
