"""Friction laws fitted to tables of measured friction against speed."""
