"""rebake in Blender: a panel that sends the scene to a rebake service, keeps it up to date with what is edited, and
shows the light map as it gets better."""

from . import live, panel, settings


def register() -> None:
    settings.register()
    panel.register()
    live.register()


def unregister() -> None:
    live.unregister()
    panel.unregister()
    settings.unregister()
