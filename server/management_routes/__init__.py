"""HTTP routes that manage: fleet, alerts, policy versions, diagnoses; one module per resource."""
