"""Makes the extension, one zip archive that Blender installs from disk: the add-on, with the core of the Python client.

`build.py [FOLDER]`, by default `dist` beside this file, prints the path of the archive.
"""

import re
import sys
import zipfile
from pathlib import Path

HERE = Path(__file__).parent
CORE = HERE.parent / "python" / "src" / "rebake" / "core"


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "dist"
    folder.mkdir(parents=True, exist_ok=True)
    manifest = (HERE / "addon" / "blender_manifest.toml").read_text()
    version = re.search(r'^version = "(.*)"$', manifest, re.MULTILINE)[1]
    archive = folder / f"rebake-{version}.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.write(HERE / "addon" / "blender_manifest.toml", "blender_manifest.toml")
        for source, inside in [(HERE / "addon", ""), (CORE, "core/")]:
            for path in sorted(source.glob("*.py")):
                file.write(path, inside + path.name)
    print(archive)


main()
