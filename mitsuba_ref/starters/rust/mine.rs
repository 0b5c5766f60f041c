// A ray caster: every triangle, in f64, for --candidate-serve; no dependency: rustc -O mine.rs
use std::convert::TryInto;
use std::io::{self, Read, Write};

type V = [f64; 3];
fn sub(a: V, b: V) -> V { [a[0] - b[0], a[1] - b[1], a[2] - b[2]] }
fn dot(a: V, b: V) -> f64 { a[0] * b[0] + a[1] * b[1] + a[2] * b[2] }
fn cross(a: V, b: V) -> V {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn block(input: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut length = [0; 8];
    input.read_exact(&mut length)?;
    let mut data = vec![0; i64::from_le_bytes(length) as usize];
    input.read_exact(&mut data)?;
    Ok(data)
}

fn floats(data: &[u8]) -> Vec<f64> {
    data.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()) as f64).collect()
}

fn cast(mesh: &[u8], rays: &[f64]) -> Vec<f32> {
    let vertices = i64::from_le_bytes(mesh[..8].try_into().unwrap()) as usize;
    let v = floats(&mesh[16..16 + 12 * vertices]);
    let corner = |b: &[u8]| { let i = 3 * i32::from_le_bytes(b.try_into().unwrap()) as usize; [v[i], v[i + 1], v[i + 2]] };
    let corners: Vec<V> = mesh[16 + 12 * vertices..].chunks_exact(4).map(corner).collect();
    let mut hits = Vec::new();
    for ray in rays.chunks_exact(8) {
        let (o, d) = ([ray[0], ray[1], ray[2]], [ray[3], ray[4], ray[5]]);
        let (mut best, mut hit) = (f64::INFINITY, [f32::INFINITY, 0.0, 0.0, 0.0, -1.0]);
        for (j, face) in corners.chunks_exact(3).enumerate() {
            let c = [sub(face[0], o), sub(face[1], o), sub(face[2], o)];
            let side = [0, 1, 2].map(|a| dot(cross(c[a], c[(a + 1) % 3]), d));
            let n = cross(sub(c[1], c[0]), sub(c[2], c[0]));
            let (slope, length) = (dot(n, d), dot(n, n).sqrt());
            let t = dot(n, c[0]) / slope;
            let outside = side.iter().any(|s| *s < 0.0) && side.iter().any(|s| *s > 0.0);
            if outside || slope == 0.0 || !(t > ray[6] && t <= ray[7] && t < best) { continue; }
            best = t;
            hit = [t as f32, (n[0] / length) as f32, (n[1] / length) as f32, (n[2] / length) as f32, j as f32];
        }
        hits.extend(hit);
    }
    hits
}

fn main() -> io::Result<()> {
    let (mut input, mut output) = (io::stdin().lock(), io::stdout().lock());
    while let Ok(mesh) = block(&mut input) {
        let rays = floats(&block(&mut input)?);
        let hits: Vec<u8> = cast(&mesh, &rays).iter().flat_map(|x| x.to_le_bytes()).collect();
        output.write_all(&(hits.len() as i64).to_le_bytes())?;
        output.write_all(&hits)?;
        output.flush()?;
    }
    Ok(())
}
