"""Export of a DAE as a Functional Mock-up Unit."""

from cosim.export.package import export_fmu

__all__ = ["export_fmu"]
