// Comfort on top of plain forms: dropping a file, progress of an upload, words for screen readers. Without it all works.
"use strict";

const announcer = document.getElementById("announcer");
function announce(words) {
  if (announcer && words && announcer.textContent !== words) announcer.textContent = words;
}

document.body.addEventListener("htmx:afterSettle", () => {
  const said = document.querySelector("[data-say]");
  if (said) announce(said.dataset.say);
});

for (const alert of document.querySelectorAll("[role=alert][tabindex]")) alert.focus();

for (const form of document.querySelectorAll("form[data-sure]")) {
  form.addEventListener("submit", (event) => {
    if (!window.confirm(form.dataset.sure)) event.preventDefault();
  });
}

const drop = document.getElementById("drop");
if (drop) {
  const input = drop.querySelector("input[name=file]");
  const bar = drop.querySelector("progress");
  const problem = document.getElementById("drop-problem");
  const button = drop.querySelector("button");
  const largest = Number(drop.dataset.largestMb) * 1e6;
  const usual = button.textContent;

  function fail(words) {
    problem.textContent = words;
    problem.hidden = false;
    bar.hidden = true;
    button.disabled = false;
    button.textContent = usual;
    problem.focus();
  }

  function send() {
    if (!input.files.length) { fail("Choose a recording first, or drop one here."); return; }
    const file = input.files[0];
    if (file.size > largest) {
      fail(`${file.name} is ${(file.size / 1e6).toFixed(0)} MB; at most ${drop.dataset.largestMb} MB are taken.`);
      return;
    }
    problem.hidden = true;
    bar.hidden = false;
    bar.removeAttribute("value");
    button.disabled = true;
    const request = new XMLHttpRequest();
    request.upload.addEventListener("progress", (event) => {
      bar.value = event.loaded / event.total;
      button.textContent = event.loaded < event.total ? `${Math.floor(100 * bar.value)} %` : "Storing …";
    });
    request.addEventListener("load", () => {
      if (request.status < 400) { window.location.assign(request.responseURL); return; }
      const page = new DOMParser().parseFromString(request.responseText, "text/html");
      const words = page.querySelector("[role=alert]");
      fail((words ? words.textContent : request.responseText).trim() || `The server said ${request.status}.`);
    });
    request.addEventListener("error", () => fail("The connection broke: is the server still running? Try again."));
    request.open("POST", drop.getAttribute("action"));
    request.send(new FormData(drop));
    announce("Uploading");
  }

  drop.addEventListener("submit", (event) => { event.preventDefault(); send(); });
  for (const name of ["dragenter", "dragover"]) {
    drop.addEventListener(name, (event) => { event.preventDefault(); drop.classList.add("over"); });
  }
  for (const name of ["dragleave", "drop"]) {
    drop.addEventListener(name, () => drop.classList.remove("over"));
  }
  drop.addEventListener("drop", (event) => {
    event.preventDefault();
    if (!event.dataTransfer.files.length) return;
    input.files = event.dataTransfer.files;
    send();
  });
  // a file that misses the field must not replace the page
  for (const name of ["dragover", "drop"]) window.addEventListener(name, (event) => event.preventDefault());
}
