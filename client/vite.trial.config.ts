import { defineConfig, type Plugin, type Rolldown } from "vite";

type Asset = Rolldown.OutputAsset;

/** The page of a replay as one file that loads nothing: `avrgym replay --html` writes a trial into it. */
export default defineConfig({
  base: "./",
  publicDir: false,
  plugins: [inOneFile("trial.html")],
  build: {
    outDir: "../src/avrgym/vr/static",
    emptyOutDir: false,
    modulePreload: false,
    chunkSizeWarningLimit: 1000,
    rolldownOptions: { input: "replay.html", output: { codeSplitting: false } },
    license: { fileName: "trial-licenses.md" },
  },
});

/** Puts script and style into the page, and with them the licences of what they contain. */
function inOneFile(fileName: string): Plugin {
  return {
    name: "in-one-file",
    enforce: "post",
    generateBundle: {
      order: "post",
      async handler(_, bundle) {
        const outputs = Object.values(bundle);
        const named = (ending: string) => outputs.find((output) => output.fileName.endsWith(ending))!;
        const text = (ending: string) => String((named(ending) as Asset).source);
        const { code } = named(".js") as Rolldown.OutputChunk;
        const source = await withinPage(text("replay.html"), code, text(".css"), text("licenses.md"));
        for (const { fileName } of outputs) delete bundle[fileName];
        this.emitFile({ type: "asset", fileName, source });
      },
    },
  };
}

async function withinPage(page: string, code: string, style: string, licences: string): Promise<string> {
  const script = code.replaceAll("</script", "<\\/script");
  const policy =
    `default-src 'none'; script-src '${await hashOf(script)}'; style-src '${await hashOf(style)}'; ` +
    "img-src blob:; connect-src blob:; form-action 'none'; base-uri 'none'";
  return page
    .replace(/<link rel="(icon|stylesheet)"[^>]*>\s*/g, "")
    .replace(/<script type="module"[^>]*><\/script>\s*/, "")
    .replace("<title>", `<meta http-equiv="Content-Security-Policy" content="${policy}" />\n    <title>`)
    .replace("</head>", () => `<style>${style}</style>\n</head>`)
    .replace("</body>", () => `<script type="module">${script}</script>\n</body>`)
    .replace("</html>", () => `</html>\n<!--\n${licences.replaceAll("--", "- -")}\n-->`);
}

/** What a content security policy calls an inline script or style by. */
async function hashOf(text: string): Promise<string> {
  const digest = await crypto.subtle.digest("SHA-256", new TextEncoder().encode(text));
  return `sha256-${btoa(String.fromCharCode(...new Uint8Array(digest)))}`;
}
