"""The cart-pole as a rig: what departs from the ideal loop, compiled around MuJoCo's `mj_step`."""
