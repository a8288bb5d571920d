"""What runs on the machine: control step, throw states, safety, drivers, the link, recorder, outbox.

Imports with its own few dependencies alone; never mujoco, fastapi, sqlalchemy, viser, jax or torch.
"""
