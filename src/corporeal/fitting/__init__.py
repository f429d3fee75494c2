"""Models fitted to data: bodies tracked through sequences of scans."""
