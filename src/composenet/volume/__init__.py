"""Frame -> Volume: the sparse surface grid and the signed distance field."""
