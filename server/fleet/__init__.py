"""What is known of the machines of a site together, and of one machine over its life."""
