"""Readers: from data files of any format, units and axes to values in SI units."""
