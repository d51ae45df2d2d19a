// Runs before the page. Measures GPU memory, draw calls, JavaScript time per frame and loading time of scenes.
(() => {
  const meter = { bytes: 0, calls: 0, triangles: 0, messagesMs: 0, frames: [], scenes: [] };
  window.pageMeter = meter;
  const sizes = new Map();
  const bound = new Map();
  const resize = (thing, bytes) => {
    if (!thing) return;
    meter.bytes += bytes - (sizes.get(thing) ?? 0);
    sizes.set(thing, bytes);
  };
  meter.largest = () => [...sizes.values()].sort((a, b) => b - a).slice(0, 12);
  const GL = WebGL2RenderingContext.prototype;
  const around = (name, before) => {
    const original = GL[name];
    GL[name] = function (...given) {
      before.call(this, ...given);
      return original.apply(this, given);
    };
  };

  // Memory of buffers, textures with mipmaps and renderbuffers, without the eye buffers, which have the size of the canvas.
  const ofEyes = (gl, width, height) => width === gl.drawingBufferWidth && height === gl.drawingBufferHeight;
  const BYTES = {
    0x8058: 4, 0x8c43: 4, 0x1908: 4, 0x8051: 3, 0x1907: 3, 0x8229: 1, 0x822b: 2, 0x881a: 8, 0x881b: 6, 0x8814: 16,
    0x822d: 2, 0x822e: 4, 0x822f: 4, 0x8230: 8, 0x8c3a: 4, 0x81a5: 2, 0x81a6: 4, 0x8cac: 4, 0x88f0: 4, 0x8cad: 8,
    0x8c41: 3, 0x8d7c: 4, 0x8d70: 16, 0x8d76: 8,
  };
  const pixel = (format) => {
    if (!(format in BYTES)) throw Error(`no size is known of the format 0x${format.toString(16)}`);
    return BYTES[format];
  };
  const layers = (target) => (target === 0x8513 ? 6 : 1);
  const levelsOf = (width, height, levels, bytes) => {
    let sum = 0;
    for (let level = 0; level < levels; level++) sum += Math.max(width >> level, 1) * Math.max(height >> level, 1) * bytes;
    return sum;
  };
  for (const kind of ["Buffer", "Texture", "Renderbuffer"]) {
    around(`bind${kind}`, (target, thing) => bound.set(`${kind}${target}`, thing));
    around(`delete${kind}`, (thing) => resize(thing, 0));
  }
  around("bufferData", (target, data) =>
    resize(bound.get(`Buffer${target}`), typeof data === "number" ? data : (data?.byteLength ?? 0)));
  around("texStorage2D", function (target, levels, format, width, height) {
    if (ofEyes(this, width, height)) return;
    resize(bound.get(`Texture${target}`), layers(target) * levelsOf(width, height, levels, pixel(format)));
  });
  around("texStorage3D", (target, levels, format, width, height, depth) =>
    resize(bound.get(`Texture${target}`), depth * levelsOf(width, height, levels, pixel(format))));
  around("texImage2D", (target, level, format, width, height, ...rest) => {
    const source = rest.length < 2 ? rest.at(-1) : null;
    const [w, h] = source ? [source.width, source.height] : [width, height];
    const cube = target >= 0x8515 && target <= 0x851a;
    if (level === 0 && Number.isFinite(w)) resize(bound.get(`Texture${cube ? 0x8513 : target}`), (cube ? 6 : 1) * w * h * pixel(format));
  });
  around("renderbufferStorage", function (target, format, width, height) {
    if (!ofEyes(this, width, height)) resize(bound.get(`Renderbuffer${target}`), width * height * pixel(format));
  });
  around("renderbufferStorageMultisample", function (target, samples, format, width, height) {
    if (ofEyes(this, width, height)) return;
    resize(bound.get(`Renderbuffer${target}`), Math.max(samples, 1) * width * height * pixel(format));
  });
  around("compressedTexImage2D", () => { throw Error("the size of compressed textures is not known"); });

  // Draw calls and triangles of a frame: both eyes and shadows. With `idle` the GPU draws nothing.
  const counted = (name, vertices) => {
    const original = GL[name];
    GL[name] = function (...given) {
      meter.calls++;
      if (given[0] === this.TRIANGLES) meter.triangles += vertices(given) / 3;
      if (!meter.idle) original.apply(this, given);
    };
  };
  counted("drawArrays", ([, , count]) => count);
  counted("drawElements", ([, count]) => count);
  counted("drawRangeElements", ([, , , count]) => count);
  counted("drawArraysInstanced", ([, , count, copies]) => count * copies);
  counted("drawElementsInstanced", ([, count, , , copies]) => count * copies);
  const clear = GL.clear;
  GL.clear = function (mask) {
    if (!meter.idle) clear.call(this, mask);
  };

  // VR frames, with the messages since the previous frame. The emulator installs its own XRSession.
  meter.watchFrames = () => {
    const session = window.XRSession.prototype;
    const request = session.requestAnimationFrame;
    session.requestAnimationFrame = function (callback) {
      return request.call(this, (time, frame) => {
        [meter.calls, meter.triangles] = [0, 0];
        const began = performance.now();
        callback(time, frame);
        meter.frames.push({ ms: performance.now() - began + meter.messagesMs, calls: meter.calls, triangles: meter.triangles });
        meter.messagesMs = 0;
        if (meter.frames.length > 3000) meter.frames.splice(0, 1000);
      });
    };
  };

  // Scenes: time from the scene message to the reply that it is loaded.
  const starts = (data, words) => {
    const head = new Uint8Array(data.buffer ?? data, data.byteOffset ?? 0, Math.min(data.byteLength, 24));
    return String.fromCharCode(...head).includes(words);
  };
  let asked = 0;
  const Socket = window.WebSocket;
  window.WebSocket = class extends Socket {
    constructor(...given) {
      super(...given);
      this.addEventListener("message", ({ data }) => {
        if (data instanceof ArrayBuffer && starts(data, "type\xa5scene\xa3")) asked = performance.now();
      });
    }
    set onmessage(take) {
      super.onmessage = (event) => {
        const began = performance.now();
        take.call(this, event);
        meter.messagesMs += performance.now() - began;
      };
    }
    send(data) {
      if (typeof data !== "string" && starts(data, "type\xacscene_loaded")) meter.scenes.push(performance.now() - asked);
      super.send(data);
    }
  };
})();
