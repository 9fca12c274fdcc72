"""What maloc is measured with, against truth and against other programs."""
