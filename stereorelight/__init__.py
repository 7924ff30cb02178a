"""stereorelight: relight live footage shot with two cameras."""

__version__ = "0.1.0"
