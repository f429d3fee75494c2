// Usage: node validate.mjs NODE_MODULES FILE.glb; prints the Khronos validator's report as JSON.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";

const [modules, file] = process.argv.slice(2);
const validator = createRequire(resolve(modules, "index.js"))("gltf-validator");
const report = await validator.validateBytes(new Uint8Array(readFileSync(file)));
console.log(JSON.stringify(report));
