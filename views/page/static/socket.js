// The connection to the viewer: acknowledges each frame, and reconnects when the connection is lost.

const FIRST_DELAY_MS = 250;
const LONGEST_DELAY_MS = 2000;
const SILENT_MS = 5000;

/** Decode a frame: the snapshot, and the pictures by name. */
export function parse(buffer, taxels) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const pictures = {};
  header.pictures.forEach((name, place) => {
    pictures[name] = new Float32Array(buffer, 4 + length + place * taxels * 4, taxels);
  });
  return { snapshot: header.snapshot, pictures };
}

export class Connection {
  /** `onSkin(greeting)` is called at every new connection, `onFrame(frame)` for every frame. `path` is that of the skin. */
  constructor(onSkin, onFrame, path = "") {
    this.url = new URL(`${path}ws`, location.href);
    this.url.protocol = location.protocol === "https:" ? "wss" : "ws";
    this.onSkin = onSkin;
    this.onFrame = onFrame;
    this.delay = FIRST_DELAY_MS;
    this.frameAt = null; // performance.now() of the newest frame
    this.lostTime = null; // Date.now() when frames stopped
    this.open();
    setInterval(() => this.watch(), 500);
  }

  open() {
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    let taxels = 0;
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") {
        const skin = JSON.parse(data);
        taxels = skin.rows * skin.columns;
        this.onSkin(skin);
        return;
      }
      socket.send("ok");
      this.delay = FIRST_DELAY_MS;
      this.frameAt = performance.now();
      this.onFrame(parse(data, taxels));
    };
    socket.onclose = () => {
      setTimeout(() => this.open(), this.delay);
      this.delay = Math.min(LONGEST_DELAY_MS, this.delay * 1.6);
    };
    this.socket = socket;
    this.openedAt = performance.now();
  }

  /** Time since the newest frame in milliseconds; infinite before the first. */
  silence() {
    return this.frameAt === null ? Infinity : performance.now() - this.frameAt;
  }

  /** Close a connection that looks open but brings nothing. */
  watch() {
    const quiet = Math.min(this.silence(), performance.now() - this.openedAt);
    if (quiet > SILENT_MS && this.socket.readyState <= WebSocket.OPEN) this.socket.close();
  }
}
