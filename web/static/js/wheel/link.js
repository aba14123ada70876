// The socket to the process that drives. It is opened again when it breaks.

const RETRY_MS = [250, 2000]; // first, longest
const MAX_WAITING_BYTES = 1 << 16; // not sent yet; with more, new controls are dropped

export class Link {
  #socket = null;
  #retry_ms = RETRY_MS[0];
  #isOver = false;

  /** `onText` gets each message, `onFrame` its description and JPEG, `onChange` whether it is open. */
  constructor(path, { onText, onFrame, onChange }) {
    Object.assign(this, { path, onText, onFrame, onChange });
    this.#open();
  }

  get isOpen() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  /** Send a message; false if that fails. */
  send(message) {
    if (!this.isOpen || this.#socket.bufferedAmount > MAX_WAITING_BYTES) return false;
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  close() {
    this.#isOver = true;
    this.#socket.close();
  }

  #open() {
    const socket = new WebSocket(new URL(this.path, location.origin.replace(/^http/, "ws")));
    this.#socket = socket;
    socket.binaryType = "arraybuffer";
    socket.addEventListener("message", ({ data }) => {
      this.#retry_ms = RETRY_MS[0];
      if (typeof data === "string") this.onText(JSON.parse(data));
      else this.onFrame(...parted(data));
    });
    socket.addEventListener("open", () => this.onChange(true));
    socket.addEventListener("close", () => {
      if (this.#isOver) return;
      this.onChange(false);
      setTimeout(() => this.#isOver || this.#open(), this.#retry_ms);
      this.#retry_ms = Math.min(2 * this.#retry_ms, RETRY_MS[1]);
    });
  }
}

/** A frame: 4 bytes with the length of its description, which is JSON, then a JPEG. */
function parted(data) {
  const length = new DataView(data).getUint32(0);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  return [about, new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" })];
}
