// The Khronos validator on files: validate.mjs FOLDER. Fails where it finds an error or a warning that the scene's own
// upload does not have.
import { readFileSync, readdirSync } from "node:fs";
import { createRequire } from "node:module";

const { validateBytes } = createRequire(process.cwd() + "/")("gltf-validator");
const folder = process.argv[2];
let failed = false;
for (const name of readdirSync(folder).filter((name) => name.endsWith(".glb")).sort()) {
  const report = await validateBytes(new Uint8Array(readFileSync(`${folder}/${name}`)), { maxIssues: 1000 });
  const { numErrors, numWarnings, numInfos, messages } = report.issues;
  console.log(`${name}: ${numErrors} errors, ${numWarnings} warnings, ${numInfos} infos`);
  const bad = messages.filter((message) => message.severity < 2);
  for (const { code, message, pointer } of bad.slice(0, 5)) console.log(`  ${code} ${pointer}: ${message}`);
  failed ||= bad.length > 0;
}
process.exit(failed ? 1 : 0);
