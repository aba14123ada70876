// The cameras' pictures at a moment. While the mouse moves, each camera loads one picture at a time, then the newest
// wanted one. Pictures in between are not loaded.

export class Pictures {
  constructor(figures, data) {
    this.data = data;
    this.cameras = [...figures].map((figure) => ({
      figure,
      name: figure.dataset.camera,
      image: figure.querySelector("img"),
      wanted: "",
      isLoading: false,
    }));
  }

  useCameras() {
    for (const camera of this.cameras) camera.figure.hidden = !this.data.state.cameras.includes(camera.name);
  }

  show(position) {
    const row = this.data.columns.row[position];
    for (const camera of this.cameras) {
      if (camera.figure.hidden) continue;
      camera.wanted = `${this.data.address}/pictures/${camera.name}/${row}?v=${this.data.state.version}`;
      if (!camera.isLoading) load(camera);
    }
  }
}

async function load(camera) {
  camera.isLoading = true;
  while (camera.wanted) {
    const address = camera.wanted;
    camera.wanted = "";
    if (camera.image.getAttribute("src") === address) continue;
    camera.image.src = address;
    try {
      await camera.image.decode();
      camera.figure.classList.remove("missing");
      camera.image.classList.toggle("enlarged", camera.image.naturalWidth < camera.image.clientWidth * devicePixelRatio);
    } catch {
      camera.figure.classList.add("missing"); // this row has no picture, or it does not decode
    }
    camera.figure.dataset.shown = address;
  }
  camera.isLoading = false;
}
