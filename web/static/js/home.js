// The newest drive, as a moving picture: its rows one after the other. Without motion, the first picture stays.

const EVERY_MS = 100;
const wantsStill = matchMedia("(prefers-reduced-motion: reduce)");
let at = 0;

async function showNext() {
  const figure = document.querySelector(".moving");
  if (figure && !document.hidden && !wantsStill.matches) {
    const { address, first, rows, version } = figure.dataset;
    at = (at + 1) % Number(rows);
    const next = new Image();
    next.src = `${address}/pictures/center/${Number(first) + at}?v=${version}`;
    try {
      await next.decode();
      figure.querySelector("img").src = next.src;
    } catch {
      return; // the log has no such picture, or is gone
    }
  }
  setTimeout(showNext, EVERY_MS);
}

addEventListener("load", () => setTimeout(showNext, 500));
