"""The way from a browser to the 3D view: page, proxy, allowed frames, clicks."""
