"""Pages in a browser, with their columns and requests."""

import time

import numpy as np

#: Longest wait for a page, on a busy machine [ms].
PATIENCE = 120_000


class Window:
    """A page in the browser, with its requests and errors."""

    def __init__(self, page, path):
        self.page, self.path, self.asked, self.complaints = page, path, [], []
        page.set_default_timeout(PATIENCE)
        page.on("request", lambda request: self.asked.append(request.url))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.goto(path if isinstance(path, str) else path.as_uri())

    def js(self, code, *arguments):
        return self.page.evaluate(code, *arguments)

    def until(self, code):
        """Wait until a function is true; the page's policy forbids the evaluation of text."""
        end = time.monotonic() + PATIENCE / 1000
        while not self.js(code):
            assert time.monotonic() < end, code
            self.page.wait_for_timeout(20)

    def column(self, name):
        """Return a column of the drawn data, exact to the bit."""
        text = self.js(
            """(name) => {
                const d = fluxobs.results.view.columns[name];
                const bytes = new Uint8Array(d.buffer, d.byteOffset, d.byteLength);
                let out = "";
                for (const b of bytes) out += b.toString(16).padStart(2, "0");
                return [d.constructor.name, out];
            }""",
            name,
        )
        kinds = {"Float64Array": "<f8", "Float32Array": "<f4", "Uint8Array": "u1"}
        return np.frombuffer(bytes.fromhex(text[1]), kinds[text[0]])

    def columns(self):
        return self.js("() => Object.keys(fluxobs.results.view.columns)")

    def silent(self):
        """Whether the page requested only itself and its worker; assert that no error occurred."""
        assert not self.complaints
        return [url for url in self.asked if not url.startswith(("file:", "blob:", "data:"))] == []
