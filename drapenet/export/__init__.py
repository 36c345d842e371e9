"""Files for simulators and design tools."""
