"""HTML reports: page template, style sheet, number formats and SVG drawings that all reports share."""
