"""What a machine is and how one speaks to it: spec, kinematics, ballistics, messages, log format.

Nothing runs here; this package only defines, with numpy and pydantic and nothing else.
"""
