// The compiled laboratory: requests as JSON, answers as JSON or bytes. Nothing of the browser is
// needed.

export class System {
  static async from(bytes) {
    const { instance } = await WebAssembly.instantiate(bytes, {});
    return new System(instance.exports);
  }

  constructor(exports) {
    this.exports = exports;
  }

  call(input, work) {
    const { memory, output, output_length: length } = this.exports;
    const at = this.exports.input(input.length);
    new Uint8Array(memory.buffer, at, input.length).set(input);
    const isGood = work();
    const answer = new Uint8Array(memory.buffer, output(), length()).slice();
    if (!isGood) {
      throw new Error(new TextDecoder().decode(answer).trim());
    }
    return answer;
  }

  bytes(request) {
    return this.call(new TextEncoder().encode(JSON.stringify(request)), this.exports.ask);
  }

  text(request) {
    return new TextDecoder().decode(this.bytes(request));
  }

  ask(request) {
    return JSON.parse(this.text(request));
  }

  replay(record) {
    return JSON.parse(new TextDecoder().decode(this.call(record, this.exports.replay)));
  }
}
