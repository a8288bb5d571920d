"""What the machine keeps: throw logs, the outbox, the journal."""
