"""From throw logs to motion on one clock, audited."""
