"""The version of the package; package.xml and setup.py carry the same (a test compares)."""

__version__ = '0.1.0'
