// A folder, zip or log is dropped or chosen, and sent in one request: a manifest, then the files one after the other.
// The browser reads them from the disk while it sends; a broken-off request leaves nothing at the server.

import { by, reasonIn, showProblem } from "./dom.js";
import { showStatus } from "./live.js";

const [drop, progress, cancel] = [by("drop"), by("progress"), by("cancel")];
const [bar, words] = progress.children;
const chosen = [by("folder"), by("file")];
const CANCELLED = "Cancelled: nothing was kept.";
let sending = null; // what can be aborted

function setBusy(isBusy) {
  progress.hidden = !isBusy;
  for (const each of chosen) each.disabled = isBusy;
  if (isBusy) cancel.focus();
}

const megabytes = (bytes) => (bytes / 1e6).toLocaleString("en", { maximumFractionDigits: bytes < 1e7 ? 1 : 0 });

function showProgress(sent, total, beganMs) {
  bar.value = sent / total;
  const passedS = (performance.now() - beganMs) / 1000;
  const leftS = Math.round((passedS / sent) * (total - sent));
  const left = passedS > 2 && leftS ? `, ${leftS} s left` : "";
  words.textContent = sent < total ? `${megabytes(sent)} of ${megabytes(total)} MB${left}` : "sent; it is being looked at";
}

function send(files) {
  if (sending) return;
  showProblem("");
  const total = files.reduce((sum, [, file]) => sum + file.size, 0);
  if (!files.length) return showProblem("There is no file in it.");
  if (files.length > +drop.dataset.maxFiles) return showProblem(`${files.length} files: at most ${drop.dataset.maxFiles} are taken.`);
  if (total > +drop.dataset.maxBytes) return showProblem(`${megabytes(total)} MB: at most ${megabytes(+drop.dataset.maxBytes)} are taken.`);
  const manifest = new TextEncoder().encode(JSON.stringify({ files: files.map(([path, file]) => [path, file.size]) }));
  const request = new XMLHttpRequest(); // fetch does not say how much it has sent
  sending = request;
  const beganMs = performance.now();
  request.upload.onprogress = ({ loaded, total: all }) => showProgress(loaded, all, beganMs);
  request.onload = () => {
    sending = null; // so that leaving needs no question
    if (request.status === 200) location.href = JSON.parse(request.responseText).page;
    else showProblem(reasonIn(request.responseText, request.status));
  };
  request.onerror = () => showProblem("It could not be sent: a file has changed or cannot be read, or bc-web was ended. Nothing was kept.");
  request.onabort = () => showStatus(CANCELLED);
  request.onloadend = () => {
    sending = null;
    setBusy(false);
    for (const each of chosen) each.value = "";
  };
  request.open("POST", `/import.upload?manifest=${manifest.length}`);
  request.setRequestHeader("Accept", "application/json");
  showProgress(0, 1, beganMs);
  words.textContent = `0 of ${megabytes(total)} MB`;
  setBusy(true);
  request.send(new Blob([manifest, ...files.map(([, file]) => file)]));
}

const read = (reader) => new Promise((done, failed) => reader.readEntries(done, failed));
const opened = (entry) => new Promise((done, failed) => entry.file(done, failed));

async function filesOf(entry) {
  if (entry.isFile) return [[entry.fullPath.slice(1), await opened(entry)]];
  const files = [];
  const reader = entry.createReader();
  for (;;) {
    const some = await read(reader); // a hundred at a time
    if (!some.length) return files;
    files.push(...(await Promise.all(some.map(filesOf))).flat());
  }
}

async function dropped(transfer) {
  const entries = [...transfer.items].map((item) => [item.webkitGetAsEntry?.(), item.getAsFile()]);
  if (sending) return;
  const listing = new AbortController();
  sending = listing;
  showProblem("");
  bar.removeAttribute("value");
  words.textContent = "its files are listed";
  setBusy(true);
  const found = entries.map(([entry, file]) => (entry ? filesOf(entry) : file ? [[file.name, file]] : []));
  const files = await Promise.all(found).catch((error) => error);
  sending = null;
  setBusy(false);
  if (listing.signal.aborted) return showStatus(CANCELLED);
  if (files instanceof Error) showProblem(`It cannot be read: ${files.message}`);
  else send(files.flat());
}

// anywhere on the page: a drop beside the frame would make the browser leave it
for (const name of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    drop.classList.toggle("over", name === "dragover");
  });
}
document.addEventListener("drop", (event) => dropped(event.dataTransfer));
for (const each of chosen) {
  each.addEventListener("change", () => send([...each.files].map((file) => [file.webkitRelativePath || file.name, file])));
}
cancel.addEventListener("click", () => sending?.abort());
addEventListener("beforeunload", (event) => {
  if (sending) event.preventDefault();
});
