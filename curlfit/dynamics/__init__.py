"""The motion of a stone: ring contact, equations, integration, the path and
its derivatives."""
