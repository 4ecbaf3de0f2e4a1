// Base64 of the bytes of an array.
export function textOf(array) {
  const bytes = new Uint8Array(array.buffer);
  let text = '';
  for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
  return btoa(text);
}
