"""The relation between flux and current, the linear system built on it, frames and inverter."""
