"""How far a loop is from instability at upright: gain, phase, disk and delay margins."""
