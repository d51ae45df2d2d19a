/** Plays one sound file at a time. A new one replaces it. */
export class SoundFiles {
  private source: AudioBufferSourceNode | null = null;
  private number = 0;

  /** `fetch` returns the bytes of a file, or none if there is no such file. */
  constructor(
    private readonly audio: () => BaseAudioContext | null,
    private readonly fetch: (url: string) => Promise<ArrayBuffer>,
  ) {}

  get playing(): boolean {
    return this.source !== null;
  }

  async play(url: string): Promise<void> {
    this.stop();
    const number = this.number;
    const bytes = await this.fetch(url);
    const audio = this.audio();
    if (bytes.byteLength === 0 || !audio) return;
    const buffer = await audio.decodeAudioData(bytes);
    if (number !== this.number) return;
    const source = audio.createBufferSource();
    Object.assign(source, { buffer, onended: () => source === this.source && this.stop() });
    source.connect(audio.destination);
    source.start();
    this.source = source;
  }

  stop(): void {
    this.number++;
    this.source?.stop();
    this.source = null;
  }
}
