// Uploads of a folder, zip or log in one request: a manifest, then the files one after the other. The browser reads
// the files from the disk while it sends. If the request breaks off, the server keeps nothing.

import { by, reasonIn, showProblem } from "./dom.js";
import { showStatus } from "./live.js";

const [drop, progress, cancel] = [by("drop"), by("progress"), by("cancel")];
const [bar, words] = progress.children;
const inputs = [by("folder"), by("file")];
const CANCELLED = "Cancelled: nothing was kept.";
let sending = null; // the request or the listing, which can be aborted

function setBusy(isBusy) {
  progress.hidden = !isBusy;
  for (const input of inputs) input.disabled = isBusy;
  if (isBusy) cancel.focus();
}

const megabytes = (bytes) => (bytes / 1e6).toLocaleString("en", { maximumFractionDigits: bytes < 1e7 ? 1 : 0 });

function showProgress(sent, total, beganMs) {
  bar.value = sent / total;
  const passedS = (performance.now() - beganMs) / 1000;
  const leftS = Math.round((passedS / sent) * (total - sent));
  const left = passedS > 2 && leftS ? `, ${leftS} s left` : "";
  words.textContent = sent < total ? `${megabytes(sent)} of ${megabytes(total)} MB${left}` : "sent; the server reads it";
}

function send(files) {
  if (sending) return;
  showProblem("");
  const total = files.reduce((sum, [, file]) => sum + file.size, 0);
  if (!files.length) return showProblem("There is no file in it.");
  if (files.length > +drop.dataset.maxFiles) return showProblem(`${files.length} files: at most ${drop.dataset.maxFiles} are allowed.`);
  if (total > +drop.dataset.maxBytes) return showProblem(`${megabytes(total)} MB: at most ${megabytes(+drop.dataset.maxBytes)} are allowed.`);
  const manifest = new TextEncoder().encode(JSON.stringify({ files: files.map(([path, file]) => [path, file.size]) }));
  const request = new XMLHttpRequest(); // fetch reports no progress
  sending = request;
  const beganMs = performance.now();
  request.upload.onprogress = ({ loaded, total: all }) => showProgress(loaded, all, beganMs);
  request.onload = () => {
    sending = null; // leaving the page asks no question
    if (request.status === 200) location.href = JSON.parse(request.responseText).page;
    else showProblem(reasonIn(request.responseText, request.status));
  };
  request.onerror = () => showProblem("The upload failed: a file has changed or is unreadable, or bc-web has ended. Nothing was kept.");
  request.onabort = () => showStatus(CANCELLED);
  request.onloadend = () => {
    sending = null;
    setBusy(false);
    for (const input of inputs) input.value = "";
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

async function filesIn(entry) {
  if (entry.isFile) return [[entry.fullPath.slice(1), await opened(entry)]];
  const files = [];
  const reader = entry.createReader();
  for (;;) {
    const entries = await read(reader); // a hundred at a time
    if (!entries.length) return files;
    for (const file of (await Promise.all(entries.map(filesIn))).flat()) files.push(file);
  }
}

async function dropped(transfer) {
  const entries = [...transfer.items].map((item) => [item.webkitGetAsEntry?.(), item.getAsFile()]);
  if (sending) return;
  const listing = new AbortController();
  sending = listing;
  showProblem("");
  bar.removeAttribute("value");
  words.textContent = "listing its files";
  setBusy(true);
  const listed = entries.map(([entry, file]) => (entry ? filesIn(entry) : file ? [[file.name, file]] : []));
  const files = await Promise.all(listed).catch((error) => error);
  sending = null;
  setBusy(false);
  if (listing.signal.aborted) return showStatus(CANCELLED);
  if (files instanceof Error) showProblem(`It is unreadable: ${files.message}`);
  else send(files.flat());
}

// on the whole page: a browser opens a file that is dropped elsewhere
for (const name of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    drop.classList.toggle("over", name === "dragover");
  });
}
document.addEventListener("drop", (event) => dropped(event.dataTransfer));
for (const input of inputs) {
  input.addEventListener("change", () => send([...input.files].map((file) => [file.webkitRelativePath || file.name, file])));
}
cancel.addEventListener("click", () => sending?.abort());
addEventListener("beforeunload", (event) => {
  if (sending) event.preventDefault();
});
