"""An examination of a drive from an ordinary log: what a service engineer would ask."""
