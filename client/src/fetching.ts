/** What the server answers to whoever has the token. */
export async function fetchBytes(url: string, token: string): Promise<ArrayBuffer> {
  const response = await fetch(url, { headers: { Authorization: `Bearer ${token}` } });
  if (!response.ok) throw new Error(`the server answered ${response.status}`);
  return response.arrayBuffer();
}
