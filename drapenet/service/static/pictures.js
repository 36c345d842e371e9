// Photographs of a camera, reduced before they are sent; and several of one drape.

const SIDE = 2016; // pixels, of the longer side: three megapixels, as in the pictures that readings are tested with
const QUALITY = 0.92;
const LARGE = 3e6; // bytes, of pictures that take a phone a minute to send
const ORIENTATION = 0x0112; // tag of EXIF
const UPRIGHT = 1;
const MOST = Number(document.body.dataset.pictures); // of one drape
const small = new WeakMap(); // what is sent, or a promise of it, by the file that was chosen

// A JPEG of at most three megapixels, upright, with the tags of the camera, which state the focal length; other files
// as they are, and those that the browser cannot read.
export async function reduced(file) {
  if (!small.has(file)) {
    small.set(file, isJpeg(file) ? jpeg(file).catch(() => file) : file);
  }
  return small.get(file);
}

const isJpeg = (file) => file.type === 'image/jpeg' || /\.jpe?g$/i.test(file.name); // some phones state no type

// Whether pictures are long to send, and can all be reduced: those of a drape and of its plate have one scale.
export const areLarge = (files) => files.every(isJpeg) && files.reduce((sum, file) => sum + file.size, 0) > LARGE;

async function jpeg(file) {
  const image = new Image();
  image.src = URL.createObjectURL(file);
  try {
    await image.decode();
    const share = SIDE / Math.max(image.naturalWidth, image.naturalHeight);
    if (share >= 1) return file;
    const canvas = document.createElement('canvas');
    [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight].map((side) => Math.round(share * side));
    const context = canvas.getContext('2d');
    context.imageSmoothingQuality = 'high';
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    const made = await new Promise((resolve) => canvas.toBlob(resolve, 'image/jpeg', QUALITY));
    const tags = upright(await file.slice(0, 1 << 18).arrayBuffer());
    return new File([made.slice(0, 2), tags, made.slice(2)], file.name, { type: 'image/jpeg' });
  } finally {
    URL.revokeObjectURL(image.src);
  }
}

// The segment of EXIF of a JPEG, which says that the picture is upright; empty if there is none.
function upright(start) {
  const data = new DataView(start);
  for (let at = 2; at + 10 < data.byteLength && data.getUint8(at) === 0xff; at += 2 + data.getUint16(at + 2)) {
    const end = at + 2 + data.getUint16(at + 2);
    if (data.getUint8(at + 1) !== 0xe1 || data.getUint32(at + 4) !== 0x45786966 || end > data.byteLength) continue; // 'Exif'
    const head = at + 10;
    const little = data.getUint16(head) === 0x4949;
    const first = head + data.getUint32(head + 4, little);
    for (let k = 0; k < data.getUint16(first, little); k += 1) {
      const entry = first + 2 + 12 * k;
      if (data.getUint16(entry, little) === ORIENTATION) data.setUint16(entry + 8, UPRIGHT, little);
    }
    return start.slice(at, end);
  }
  return new ArrayBuffer(0);
}

// The pictures of a drape with those that are added, under names that say so.
export async function together(pictures, added) {
  const all = [];
  for (const [k, file] of [...pictures, ...added].slice(0, MOST).entries()) {
    const sent = await reduced(file);
    const named = new File([sent], `outline_${k + 1}${/\.\w+$/.exec(file.name)?.[0] ?? '.jpg'}`, { type: sent.type });
    small.set(named, named);
    all.push(named);
  }
  return all;
}

export const isFull = (pictures) => pictures.length >= MOST;
