// Keeps the page itself, so that it opens while the network is away. What is live is never kept here: the page keeps
// its last state with its time, and shows how old that is.

const SHELL = "tilth-shell";

self.addEventListener("install", () => self.skipWaiting());
self.addEventListener("activate", (event) => event.waitUntil(self.clients.claim()));

// The network first: a new release is seen at once. Only what was fetched well is kept.
self.addEventListener("fetch", (event) => {
  const { request } = event, { origin, pathname } = new URL(request.url);
  const part = pathname === "/" || /\.(js|css|svg|webmanifest)$/.test(pathname);
  if (request.method === "GET" && origin === location.origin && part) event.respondWith(fetched(request));
});

async function fetched(request) {
  const shell = await caches.open(SHELL);
  try {
    const answer = await fetch(request);
    if (answer.ok && !answer.redirected && answer.type === "basic") await shell.put(request, answer.clone());
    return answer;
  } catch (lost) {
    const kept = await shell.match(request, { ignoreVary: true });
    if (kept) return kept;
    throw lost;
  }
}
