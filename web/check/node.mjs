// The laboratory in Node:
//     node node.mjs SITE trajectory SCENARIO   prints the trajectory as CSV
//     node node.mjs SITE replay RECORD         replays a record, prints its digest
//     node node.mjs SITE time SCENARIO         prints the processor time of a simulation, the best of three, in s

import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [site, what, file] = process.argv.slice(2);
const { System } = await import(pathToFileURL(`${site}/system.js`));
const system = await System.from(readFileSync(`${site}/singletrack.wasm`));
const simulate = () => system.bytes({ command: "simulate", toml: readFileSync(file, "utf8") });

const commands = {
  trajectory: () => process.stdout.write(simulate()),
  replay: () => {
    const { ticks, different, digest } = system.replay(readFileSync(file));
    if (ticks === 0 || different > 0) {
      throw new Error(`${different} of ${ticks} ticks differ`);
    }
    console.log(digest);
  },
  time: () => {
    const times = [0, 1, 2].map(() => {
      const before = process.cpuUsage();
      simulate();
      const { user, system: kernel } = process.cpuUsage(before);
      return user + kernel;
    });
    console.log((Math.min(...times) / 1e6).toFixed(4));
  },
};
commands[what]();
