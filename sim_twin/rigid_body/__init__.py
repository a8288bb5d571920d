"""The machine's rigid bodies: the twin's MuJoCo model, gravity loads of the arm, the grip point."""
