"""C sources of the FMU runtime; `cosim.resources` reads them."""
