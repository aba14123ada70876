"""eventlet, without the notice of its own retirement that it shows to everyone who imports it.

The user asked for eventlet; whoever starts a drive can do nothing about the notice.
"""

import warnings

with warnings.catch_warnings():
    warnings.filterwarnings("ignore", message=r"\s*Eventlet is deprecated")
    import eventlet
    import eventlet.greenio
    import eventlet.wsgi

__all__ = ["eventlet"]
