"""The virtual machine: pressure-level hydraulics, a body, sensors; shares no actuation with the twin."""
