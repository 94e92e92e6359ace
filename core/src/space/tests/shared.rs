//! Triangles smaller than light needs share elements.

use super::*;

/// A square metre in `n` × `n` squares.
fn grid(n: u32) -> Mesh {
    let at = |k: u32| Vec3::new((k % (n + 1)) as f32, (k / (n + 1)) as f32, 0.0) / n as f32;
    let positions: Vec<Vec3> = (0..(n + 1) * (n + 1)).map(at).collect();
    let square = |k: u32| {
        let a = k / n * (n + 1) + k % n;
        [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
    };
    let triangles: Vec<[u32; 3]> = (0..n * n).flat_map(square).collect();
    let normals = vec![Vec3::Z; positions.len()];
    Mesh { positions, normals, triangle_materials: vec![0; triangles.len()], triangles, ..Mesh::default() }
}

/// What is read at random points, less what there is: `field` at a place with a normal.
fn differences(laid: &Laid, field: impl Fn(Vec3, Vec3) -> f32) -> Vec<f32> {
    let (corners, mut rng) = (laid.corners(), Pcg32::new(5, 3));
    let values: Vec<f32> = corners.iter().zip(&laid.elements.normals).map(|(at, n)| field(*at, *n)).collect();
    let of_face = |face: usize| {
        let (u, v) = uniform_barycentrics([rng.next_f32(), rng.next_f32()]);
        let weights = [1.0 - u - v, u, v];
        let place = laid.layout.cells.locate(face as u32, weights);
        assert!((place.weights.iter().sum::<f32>() - 1.0).abs() < 1e-5 && place.weights.iter().all(|w| *w >= 0.0));
        let read: f32 = place.elements.iter().zip(place.weights).map(|(&e, w)| values[e as usize] * w).sum();
        let mix = |list: &[Vec3]| -> Vec3 {
            laid.surface.triangles[face].iter().zip(weights).map(|(&vertex, w)| list[vertex as usize] * w).sum()
        };
        read - field(mix(&laid.surface.positions), mix(&laid.surface.normals).normalize())
    };
    (0..laid.surface.triangles.len()).map(of_face).collect()
}

fn rms(values: &[f32]) -> f64 {
    (values.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

fn check(laid: &Laid) {
    assert!((laid.area() / laid.surface.area() - 1.0).abs() < 1e-4);
    assert_eq!(laid.layout.len(), laid.elements.positions.len());
    assert_eq!(laid.layout.cell_count(), laid.surface.triangles.len());
    let is_read = laid.cells().iter().flat_map(|cell| cell.elements).collect::<BTreeSet<u32>>();
    assert_eq!(is_read.len(), laid.layout.len(), "every element is one of some cell");
    let neighbours = |element: u32| laid.layout.neighbours_of(element).any(|other| other == element);
    assert!(!(0..laid.layout.len() as u32).any(neighbours));
}

#[test]
fn a_fine_grid_has_as_many_elements_as_a_plain_square() {
    let plain = lay(Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), 0.25);
    let laid = lay(grid(60), 0.25);
    check(&laid);
    assert!(laid.layout.len() <= 3 * plain.layout.len(), "{} for {}", laid.layout.len(), plain.layout.len());
    let length = |cell: &Patch, k: usize| {
        let [a, b] = [k, (k + 1) % 3].map(|k| laid.elements.positions[cell.elements[k] as usize]);
        a.distance(b)
    };
    let lengths: Vec<f32> = laid.cells().iter().flat_map(|cell| [0, 1, 2].map(|k| length(cell, k))).collect();
    assert!((0.1..=0.26).contains(&rms(&lengths)), "{}", rms(&lengths));
    // What changes evenly is read as it is, but for triangles that lie across the edges between elements.
    let off = differences(&laid, |at, _| at.x + 0.5 * at.y);
    assert!(rms(&off) < 0.01, "{}", rms(&off));
    assert!(off.iter().all(|off| off.abs() < 0.06), "{:?}", off.iter().copied().fold(0.0, f32::max));
    // A count tells as many.
    assert_eq!(Layout::count(&laid.surface, &Distances::even(0.25), LIMIT), Ok(laid.layout.len()));
}

#[test]
fn a_round_thing_has_as_many_elements_as_its_normals_need() {
    let smooth = Mesh::icosphere(0.1, 5);
    let flat = Mesh { normals: Vec::new(), ..smooth.clone() };
    for (mesh, is_smooth) in [(smooth, true), (flat, false)] {
        let laid = lay(mesh, 1.0);
        check(&laid);
        assert!((30..=140).contains(&laid.layout.len()), "{is_smooth}: {}", laid.layout.len());
        // Light from above, as a lamp without an extent gives it and as a sky does.
        let [lamp, sky] =
            [|n: Vec3| n.y.max(0.0), |n: Vec3| 0.5 + 0.5 * n.y].map(|light| rms(&differences(&laid, |_, n| light(n))));
        assert!(lamp < 0.06 && sky < 0.03, "{is_smooth}: {lamp} {sky}");
    }
}

#[test]
fn small_pieces_have_one_element_each() {
    let mut leaves = Mesh::default();
    for k in 0..50 {
        let at = Vec3::new(0.1 * k as f32, 0.0, 0.0);
        let leaf = Mesh::quad(at, Vec3::X * 0.02, Vec3::new(0.0, 0.01, 0.02));
        let first = leaves.positions.len() as u32;
        leaves.triangles.extend(leaf.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
        leaves.positions.extend(leaf.positions);
        leaves.normals.extend(leaf.normals);
    }
    leaves.triangle_materials = vec![0; leaves.triangles.len()];
    let laid = lay(leaves.clone(), 0.5);
    check(&laid);
    assert_eq!(laid.layout.len(), 50);
    // At a distance that is theirs, they keep what they have.
    assert_eq!(lay(leaves, 0.04).layout.len(), 200);
}

/// A thin tube of eight sides, as wires and chair legs have them, and what is so small that it has a few elements.
#[test]
fn tubes_are_thinned_out_along_themselves() {
    let at = |ring: u32, k: u32| {
        let turn = k as f32 * std::f32::consts::TAU / 8.0;
        (Vec3::new(turn.cos(), turn.sin(), 0.0), Vec3::new(0.01 * turn.cos(), 0.01 * turn.sin(), 0.01 * ring as f32))
    };
    let tube = |rings: u32| {
        let vertices = (0..=rings).flat_map(|ring| (0..8).map(move |k| at(ring, k)));
        let (normals, positions): (Vec<Vec3>, Vec<Vec3>) = vertices.unzip();
        let quad = |n: u32| {
            let (ring, k) = (n / 8, n % 8);
            let [a, b] = [8 * ring + k, 8 * ring + (k + 1) % 8];
            [[a, b, b + 8], [a, b + 8, a + 8]]
        };
        let triangles: Vec<[u32; 3]> = (0..8 * rings).flat_map(quad).collect();
        Mesh { positions, normals, triangle_materials: vec![0; triangles.len()], triangles, ..Mesh::default() }
    };
    let laid = lay(tube(200), 0.2);
    check(&laid);
    assert!((8 * 10..8 * 50).contains(&laid.layout.len()), "{}", laid.layout.len());
    assert!(rms(&differences(&laid, |at, n| at.z + n.x)) < 0.05);
    let laid = lay(tube(4), 0.4);
    check(&laid);
    assert_eq!(laid.layout.len(), 4);
}

/// A square in a corner of which the file's triangles are fine.
#[test]
fn fine_triangles_beside_large_ones_share_elements_without_holes() {
    let mut mesh = grid(40);
    for (index, at) in mesh.positions.iter_mut().enumerate() {
        // The last column and row lie far out.
        let (x, y) = (index % 41, index / 41);
        at.x = if x == 40 { 6.0 } else { at.x };
        at.y = if y == 40 { 6.0 } else { at.y };
    }
    let laid = lay(mesh, 0.3);
    assert!((laid.area() / laid.surface.area() - 1.0).abs() < 1e-4);
    let even = lay(Mesh::quad(Vec3::ZERO, Vec3::X * 6.0, Vec3::Y * 6.0), 0.3);
    assert!(laid.layout.len() < 5 * even.layout.len(), "{} {}", laid.layout.len(), even.layout.len());
    let off = differences(&laid, |at, _| at.x - at.y);
    assert!(rms(&off) < 0.02, "{}", rms(&off));
}

#[test]
fn the_same_on_any_number_of_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| lay(Mesh::icosphere(0.3, 5), 0.4))
    };
    let (one, four) = (on(1), on(4));
    assert_eq!(one.elements.positions, four.elements.positions);
    assert_eq!(one.layout.cells.reads, four.layout.cells.reads);
}

/// Surfaces that are none: triangles twice, back to back, edges of three, points of many fans.
#[test]
fn what_is_no_surface_keeps_its_vertices() {
    let mut mesh = grid(12);
    let more: Vec<[u32; 3]> = mesh.triangles.iter().step_by(3).map(|&[a, b, c]| [b, a, c]).collect();
    let again: Vec<[u32; 3]> = mesh.triangles.iter().step_by(5).copied().collect();
    mesh.triangles.extend(more.into_iter().chain(again));
    mesh.triangle_materials = vec![0; mesh.triangles.len()];
    let laid = lay(mesh, 2.0);
    assert!((laid.area() / laid.surface.area() - 1.0).abs() < 1e-4);
    assert!(rms(&differences(&laid, |at, _| at.x + at.y)) < 0.05);
}

/// A flat fan of very many triangles around one point, and the same with vertices of their own: done in no time.
#[test]
fn points_of_very_many_triangles_cost_little() {
    const COUNT: u32 = 200_000;
    let turn = |k: u32| f64::from(k) * std::f64::consts::TAU / f64::from(COUNT);
    let rim = |k: u32| Vec3::new(turn(k).cos() as f32, turn(k).sin() as f32, 0.5 * (k % 2) as f32 * 1e-3);
    let mut mesh = Mesh { positions: vec![Vec3::ZERO], ..Mesh::default() };
    mesh.positions.extend((0..COUNT).map(rim));
    mesh.triangles = (0..COUNT).map(|k| [0, 1 + k, 1 + (k + 1) % COUNT]).collect();
    mesh.triangle_materials = vec![0; COUNT as usize];
    let smooth = Mesh { normals: vec![Vec3::Z; mesh.positions.len()], ..mesh.clone() };
    for mesh in [mesh, smooth] {
        let laid = lay(mesh, 2.0);
        assert!((laid.area() / laid.surface.area() - 1.0).abs() < 1e-3);
    }
}
