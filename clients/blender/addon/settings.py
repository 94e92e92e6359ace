"""Settings: of a scene, kept in its file, and the token, kept in the preferences."""

from __future__ import annotations

import os
from urllib.parse import urlsplit

import bpy


class Settings(bpy.types.PropertyGroup):
    """What a scene is sent with."""

    server: bpy.props.StringProperty(name="Service", default="http://127.0.0.1:7878", description="Where rebake serves")
    only_selected: bpy.props.BoolProperty(
        name="Selected Only", description="Send what is selected now, and what comes new, instead of the whole scene"
    )
    texels_per_metre: bpy.props.FloatProperty(
        name="Texels / m", default=20, min=0.1, soft_max=100, description="Texels of the light map per metre of surface"
    )
    spacing: bpy.props.FloatProperty(
        name="Spacing",
        default=0,
        min=0,
        soft_max=1,
        unit="LENGTH",
        description="Largest distance between elements, which hold the light; 0 leaves the choice to the service",
    )
    samples: bpy.props.IntProperty(
        name="Samples", default=64, min=1, max=65536, description="Samples per element of bakes and of updates"
    )
    target: bpy.props.EnumProperty(
        name="Target",
        items=[
            ("IMAGE", "Image", "The image “rebake light map” and the UV map “Lightmap”"),
            ("COLORS", "Color Attribute", "The attribute “rebake light map” at corners, for finely divided meshes"),
        ],
        description="What holds the light map",
    )
    follow_edits: bpy.props.BoolProperty(
        name="Live", default=True, description="Send what is edited: moves, objects that come and go, colours, lights"
    )


class Preferences(bpy.types.AddonPreferences):
    """What belongs to the user and not to a file."""

    bl_idname = __package__

    token: bpy.props.StringProperty(
        name="Token", subtype="PASSWORD", description="What the service asks for, where it does"
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "token")


def token() -> str | None:
    """The token: of the preferences, else of the environment variable REBAKE_TOKEN."""
    addon = bpy.context.preferences.addons.get(__package__)
    found = addon.preferences.token if addon and addon.preferences else ""
    return found or os.environ.get("REBAKE_TOKEN") or None


def may_reach(server: str) -> bool:
    """Other machines are reached only where Blender may go online."""
    return urlsplit(server).hostname in ("127.0.0.1", "localhost", "::1") or bpy.app.online_access


def register() -> None:
    bpy.utils.register_class(Settings)
    bpy.utils.register_class(Preferences)
    bpy.types.Scene.rebake = bpy.props.PointerProperty(type=Settings)


def unregister() -> None:
    del bpy.types.Scene.rebake
    bpy.utils.unregister_class(Preferences)
    bpy.utils.unregister_class(Settings)
