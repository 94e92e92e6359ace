"""The panel in the render properties, beside that of Cycles' bake, and what its buttons do."""

from __future__ import annotations

import bpy

from . import display, live, settings
from .core.problems import RebakeError


class REBAKE_OT_bake(bpy.types.Operator):
    """Send the scene to the service, bake it, and keep it up to date with what is edited"""

    bl_idname = "rebake.bake"
    bl_label = "Bake Light Map"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.mode == "OBJECT"

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not settings.may_reach(context.scene.rebake.server):
            self.report({"ERROR"}, "Blender may not go online: Preferences > System > Network > Allow Online Access")
            return {"CANCELLED"}
        try:
            live.start(context.scene)
        except (RebakeError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class _OfLink(bpy.types.Operator):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return live.link is not None


class REBAKE_OT_cancel(_OfLink):
    """Stop the work on the light map; it stays as it is"""

    bl_idname = "rebake.cancel"
    bl_label = "Cancel"

    def execute(self, context: bpy.types.Context) -> set[str]:
        live.link.cancel()
        return {"FINISHED"}


class REBAKE_OT_stop(_OfLink):
    """Send no more edits; the light map stays as it is"""

    bl_idname = "rebake.stop"
    bl_label = "Disconnect"

    def execute(self, context: bpy.types.Context) -> set[str]:
        live.stop()
        return {"FINISHED"}


class REBAKE_OT_show(bpy.types.Operator):
    """Show the light map on the materials, or the materials as they were"""

    bl_idname = "rebake.show"
    bl_label = "Show Light Map"
    bl_options = {"UNDO"}

    on: bpy.props.BoolProperty(default=True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return display.IMAGE in bpy.data.images

    def execute(self, context: bpy.types.Context) -> set[str]:
        image = bpy.data.images[display.IMAGE]
        for material in bpy.data.materials:
            if not self.on:
                display.hide(material)
            elif any(display.SCALE in one for one in context.scene.objects if material.name in one.material_slots):
                display.show(material, image)
        return {"FINISHED"}


class REBAKE_PT_panel(bpy.types.Panel):
    """rebake, in the render properties."""

    bl_label = "rebake"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        wanted, link = context.scene.rebake, live.link
        column = layout.column()
        column.enabled = link is None
        for name in ("server", "only_selected", "target", "texels_per_metre", "spacing", "samples"):
            column.prop(wanted, name)
        layout.prop(wanted, "follow_edits")
        row = layout.row(align=True)
        row.operator("rebake.bake", text="Bake Light Map" if link is None else "Bake Anew", icon="RENDER_STILL")
        row.operator("rebake.stop", text="", icon="X")
        shown = any(display.is_shown(material) for material in bpy.data.materials)
        toggle = layout.operator("rebake.show", text="Hide Light Map" if shown else "Show Light Map")
        toggle.on = not shown
        if link is not None:
            _status(layout, link)


def _status(layout: bpy.types.UILayout, link: live.Link) -> None:
    status, job = link.status, link.status.job
    if status.problem:
        layout.label(text=status.problem, icon="ERROR")
    if job is not None and not job.has_ended:
        row = layout.row(align=True)
        left = job.progress.remaining_ms
        text = "waits" if job.state == "queued" else f"{job.kind}, {left / 1000:.0f} s left" if left else job.kind
        row.progress(factor=job.progress.fraction, text=text)
        row.operator("rebake.cancel", text="", icon="CANCEL")
    elif not link.is_ready and not status.problem:
        layout.label(text="Sending the scene …")
    if status.version:
        error = "no error stated" if status.stated_error is None else f"stated error {status.stated_error:.4f}"
        layout.label(text=f"{status.elements} elements, {error}")
    if link.unshown:
        layout.label(text=f"Shown without their light: {', '.join(sorted(link.unshown))}", icon="INFO")
    for warning in status.warnings:
        layout.label(text=warning, icon="INFO")


CLASSES = (REBAKE_OT_bake, REBAKE_OT_cancel, REBAKE_OT_stop, REBAKE_OT_show, REBAKE_PT_panel)


def register() -> None:
    for one in CLASSES:
        bpy.utils.register_class(one)


def unregister() -> None:
    for one in reversed(CLASSES):
        bpy.utils.unregister_class(one)
