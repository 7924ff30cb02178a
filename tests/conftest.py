"""One hypothesis profile for every test: no deadlines on a busy machine, fifty examples unless a test asks otherwise."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("stereorelight", deadline=None, max_examples=50)
settings.load_profile("stereorelight")
