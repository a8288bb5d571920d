"""Model of a healthy machine of the type: learned filters, channel noise and scatter."""
