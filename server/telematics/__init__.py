"""The fleet as ISO 15143-3 (AEMP 2.0) telematics data, for fleet management systems of others."""
