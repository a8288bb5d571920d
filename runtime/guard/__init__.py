"""What the safety gate knows by itself; it shares no code with policy, controller and throw protocol."""
