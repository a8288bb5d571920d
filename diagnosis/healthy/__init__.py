"""What a healthy machine of the type looks like: learned filters, noise and scatter."""
