//! View synthesis alone, synchronization perfect: the true images of all cameras at one instant,
//! blended to the true views between them, over each proxy and with each option.
//!
//! `cargo bench --bench lumigraph -- CAPTURE [OUT]`: a filmed capture with `truth/`; rendered
//! views go to OUT. POINTS sets the number of corners that the meshes are built on, HELD_OUT adds the
//! filming cameras' views, each from the other cameras, and ONLY selects lines of the table. Prints the
//! PSNR of all pixels with coverage, as mean and minimum of the views, and processor milliseconds per
//! view.

use nalgebra::{Point2, Point3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use stlfr::camera::Camera;
use stlfr::capture::{Truth, TruthView, read_array};
use stlfr::lumigraph::{
    BlendMethod, BlendOptions, DepthEdges, DepthMap, Mesh, Plane, Proxy, Rendered, Source, blend,
    triangulate,
};
use stlfr::random::Random;
use stlfr::raster::{BitDepth, Image, read_image, write_image};

struct View {
    id: String,
    like: Option<String>,
    camera: Camera,
    image: Image,
    depth: DepthMap,
}

/// One view to render, and its sources.
struct Problem<'a> {
    view: &'a View,
    cameras: Vec<&'a View>,
    points: Vec<Point3<f64>>,
}

fn load(truth: &Truth, view: &TruthView) -> View {
    let path = |p: &str| truth.file(p).expect("file of the truth");
    let (width, height, depths) = read_array(&path(&view.depth)).expect("depth");
    View {
        id: view.id.clone(),
        like: view.like.clone(),
        camera: view.camera.camera().expect("camera"),
        image: read_image(&path(&view.image)).expect("image").0,
        depth: DepthMap::from_data(width, height, depths),
    }
}

/// The strongest corners (smaller eigenvalue of the structure tensor), `gap` pixels apart.
fn corners(image: &Image, count: usize, gap: i64) -> Vec<(usize, usize)> {
    let gray = image.to_gray();
    let (w, h) = (gray.width(), gray.height());
    let gradient = |x: usize, y: usize| {
        let at = |x: usize, y: usize| gray.pixel(x, y)[0];
        (at(x + 1, y) - at(x - 1, y), at(x, y + 1) - at(x, y - 1))
    };
    let mut strength = Vec::new();
    for y in 3..h - 3 {
        for x in 3..w - 3 {
            let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
            for v in y - 2..=y + 2 {
                for u in x - 2..=x + 2 {
                    let (gx, gy) = gradient(u, v);
                    xx += gx * gx;
                    xy += gx * gy;
                    yy += gy * gy;
                }
            }
            let half: f32 = 0.5 * (xx - yy);
            strength.push((0.5 * (xx + yy) - half.hypot(xy), x, y));
        }
    }
    strength.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.2, a.1).cmp(&(b.2, b.1))));
    let mut taken: Vec<(usize, usize)> = Vec::new();
    let mut blocked = vec![false; w * h];
    for (s, x, y) in strength {
        if taken.len() == count || s < 1e-3 {
            break;
        }
        if blocked[y * w + x] {
            continue;
        }
        taken.push((x, y));
        for v in (y as i64 - gap).max(0)..=(y as i64 + gap).min(h as i64 - 1) {
            for u in (x as i64 - gap).max(0)..=(x as i64 + gap).min(w as i64 - 1) {
                blocked[v as usize * w + u as usize] = true;
            }
        }
    }
    taken
}

/// Triangulated corners of the two nearest cameras, observed in four with 0.2 px of noise; 2 % of them
/// are mismatched.
fn points(view: &View, cameras: &[&View], count: usize) -> Vec<Point3<f64>> {
    let mut random = Random::new(5);
    let mut nearest = cameras.to_vec();
    let distance = |v: &View| (v.camera.center() - view.camera.center()).norm();
    nearest.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    nearest.truncate(4);
    let mut out = Vec::new();
    for from in &nearest[..2] {
        for (x, y) in corners(&from.image, count / 2, 3) {
            let pixel = Point2::new(x as f64 + 0.5, y as f64 + 0.5);
            let Some(ray) = from.camera.ray_world(&pixel) else { continue };
            let point = from.camera.center() + ray * f64::from(from.depth.row(y)[x]);
            let wrong = random.unit() < 0.02;
            let observations: Vec<_> = nearest
                .iter()
                .filter_map(|v| {
                    let mut at = v.camera.project(&point)?;
                    at.x += 0.2 * random.gaussian();
                    at.y += 0.2 * random.gaussian();
                    if wrong {
                        at.x += 20.0 * random.gaussian();
                    }
                    Some((&v.camera, at))
                })
                .collect();
            if let Some(t) = triangulate(&observations)
                && t.rms_px < 1.0
            {
                out.push(t.point);
            }
        }
    }
    out
}

/// PSNR of the pixels that any camera sees, dB.
fn psnr(rendered: &Rendered, truth: &Image) -> f64 {
    let pixels = rendered.image.data().chunks(3).zip(truth.data().chunks(3));
    let (mut sum, mut count) = (0.0, 0);
    for ((a, b), _) in pixels.zip(&rendered.coverage).filter(|(_, covered)| **covered) {
        sum += a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        count += 3;
    }
    -10.0 * (sum / f64::from(count)).log10()
}

const REPEATS: u32 = 5;

/// Processor time of all threads so far, in ticks of 10 ms, without other processes.
/// 0 where the system doesn't count it.
fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // After the name in parentheses: user and system time are fields 12 and 13.
    let fields: Vec<&str> =
        text.rsplit_once(')').map_or(vec![], |(_, rest)| rest.split_whitespace().collect());
    let ticks = |k: usize| fields.get(k).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) * 10.0
}

/// Origin of a view's depths.
enum Shape {
    Proxy(Proxy),
    /// The true depths of the view.
    True(DepthMap),
}

impl Shape {
    fn depth_map(&self, camera: &Camera) -> DepthMap {
        match self {
            Self::Proxy(proxy) => proxy.depth_map(camera),
            Self::True(depth) => depth.clone(),
        }
    }
}

/// The depths of every camera that occlude points in it.
#[derive(Clone, Copy)]
enum Occlusion {
    None,
    /// The proxy, rasterized in every camera.
    Proxy,
    /// The true depths.
    Truth,
}

impl Occlusion {
    fn maps(self, shape: &Shape, cameras: &[&View]) -> Vec<DepthMap> {
        match self {
            Self::None => Vec::new(),
            Self::Proxy => cameras.iter().map(|c| shape.depth_map(&c.camera)).collect(),
            Self::Truth => cameras.iter().map(|c| c.depth.clone()).collect(),
        }
    }
}

/// One line of the table: what is rendered, and how.
struct Line<'a> {
    name: &'a str,
    /// Name of its pictures, if they are written.
    file: Option<&'a str>,
    options: &'a BlendOptions,
    occlusion: Occlusion,
}

impl<'a> Line<'a> {
    fn new(
        name: &'a str,
        file: Option<&'a str>,
        options: &'a BlendOptions,
        occlusion: Occlusion,
    ) -> Self {
        Self { name, file, options, occlusion }
    }
}

struct Bench<'a> {
    problems: &'a [Problem<'a>],
    out: Option<PathBuf>,
}

impl Bench<'_> {
    /// Measures and prints one line of the table; also writes its pictures if it has a file name.
    fn line(&self, line: Line, proxy: &dyn Fn(&Problem) -> Shape) {
        let Line { name, file, options, occlusion } = line;
        if std::env::var("ONLY").is_ok_and(|only| !name.contains(&only)) {
            return;
        }
        let (mut scores, mut proxy_ms, mut blend_ms) = (Vec::new(), 0.0, 0.0);
        for p in self.problems {
            let start = cpu_ms();
            for _ in 1..REPEATS {
                proxy(p).depth_map(&p.view.camera);
            }
            let shape = proxy(p);
            let depth = shape.depth_map(&p.view.camera);
            proxy_ms += (cpu_ms() - start) / f64::from(REPEATS);
            let maps = occlusion.maps(&shape, &p.cameras);
            let sources: Vec<Source> = p
                .cameras
                .iter()
                .enumerate()
                .map(|(k, c)| Source { depth: maps.get(k), ..Source::new(&c.camera, &c.image) })
                .collect();
            let start = cpu_ms();
            for _ in 1..REPEATS {
                blend(&sources, &depth, &p.view.camera, options);
            }
            let rendered = blend(&sources, &depth, &p.view.camera, options);
            blend_ms += (cpu_ms() - start) / f64::from(REPEATS);
            scores.push(psnr(&rendered, &p.view.image));
            if let (Some(out), Some(file)) = (&self.out, file) {
                write_pictures(out, &format!("{}-{file}", p.view.id), &rendered, &depth);
            }
        }
        let n = scores.len() as f64;
        let mean = scores.iter().sum::<f64>() / n;
        let worst = scores.iter().copied().fold(f64::INFINITY, f64::min);
        println!("{name:44} {mean:6.2} {worst:6.2} {:8.1} {:8.1}", proxy_ms / n, blend_ms / n);
    }
}

/// Writes the view, and its inverse depth over the largest.
fn write_pictures(out: &Path, name: &str, rendered: &Rendered, depth: &DepthMap) {
    let path = out.join(format!("{name}.png"));
    write_image(&path, &rendered.image, None, BitDepth::Eight).expect("picture");
    let near = depth.data().iter().copied().fold(f32::INFINITY, f32::min);
    let gray = depth.data().iter().map(|z| near / z).collect();
    let map = Image::from_data(depth.width(), depth.height(), 1, gray);
    let path = out.join(format!("{name}-depth.png"));
    write_image(&path, &map, None, BitDepth::Eight).expect("picture");
}

/// The defaults with one blending option changed, and that option's name.
fn blend_variants(base: &BlendOptions) -> Vec<(String, BlendOptions)> {
    let mut blends: Vec<(String, BlendOptions)> =
        vec![("uniform".into(), BlendOptions { method: BlendMethod::Uniform, ..base.clone() })];
    for cameras in [1, 2, 3, 4, 8] {
        blends.push((format!("k {cameras}"), BlendOptions { cameras, ..base.clone() }));
    }
    for weight_step_px in [1, 2, 8, 16] {
        let name = format!("weights every {weight_step_px} px");
        blends.push((name, BlendOptions { weight_step_px, ..base.clone() }));
    }
    blends
}

fn sweep(name: &str, problems: &[Problem], out: Option<PathBuf>) {
    println!("\n{name}: {} views of {} cameras", problems.len(), problems[0].cameras.len());
    println!("{:44} {:>6} {:>6} {:>8} {:>8}", "", "dB", "worst", "proxy", "blend");
    let bench = Bench { problems, out };
    let base = BlendOptions::default();
    let depth = |p: &Problem| Shape::True(p.view.depth.clone());
    let plane = |p: &Problem| {
        let plane = Plane::fit(&p.points, &p.view.camera).expect("points");
        Shape::Proxy(Proxy::Plane(plane))
    };
    let mesh_of = |p: &Problem, depth_edges: DepthEdges| {
        let mesh = Mesh::build(&p.points, &p.view.camera, depth_edges).expect("points");
        Shape::Proxy(Proxy::Mesh(mesh))
    };
    let mesh = |p: &Problem| mesh_of(p, DepthEdges::default());

    bench.line(Line::new("true depth", Some("depth"), &base, Occlusion::None), &depth);
    bench.line(
        Line::new(
            "true depth, occluded by true depth",
            Some("depth-occluded"),
            &base,
            Occlusion::Truth,
        ),
        &depth,
    );
    bench.line(Line::new("plane", Some("plane"), &base, Occlusion::None), &plane);
    bench.line(Line::new("mesh", Some("mesh"), &base, Occlusion::None), &mesh);
    bench.line(Line::new("mesh, occluded by mesh", None, &base, Occlusion::Proxy), &mesh);
    bench.line(Line::new("mesh, occluded by true depth", None, &base, Occlusion::Truth), &mesh);
    for depth_edges in [DepthEdges::Stretch, DepthEdges::Back, DepthEdges::Front, DepthEdges::Cut] {
        let name = format!("mesh, {depth_edges:?}");
        let file = format!("mesh-{depth_edges:?}");
        bench.line(Line::new(&name, Some(&file), &base, Occlusion::None), &|p| {
            mesh_of(p, depth_edges)
        });
    }
    for (name, options) in &blend_variants(&base) {
        bench.line(
            Line::new(&format!("true depth occluded, {name}"), None, options, Occlusion::Truth),
            &depth,
        );
        bench.line(Line::new(&format!("mesh, {name}"), None, options, Occlusion::None), &mesh);
        bench.line(Line::new(&format!("plane, {name}"), None, options, Occlusion::None), &plane);
    }
}

fn main() {
    let mut arguments = std::env::args().skip(1).filter(|a| !a.starts_with("--"));
    let Some(capture) = arguments.next() else {
        println!("usage: cargo bench --bench lumigraph -- CAPTURE [OUT]");
        return;
    };
    let out = arguments.next().map(PathBuf::from);
    if let Some(out) = &out {
        std::fs::create_dir_all(out).expect("folder");
    }
    let truth = Truth::open(Path::new(&capture)).expect("truth").expect("a capture with truth");
    let mut instants: BTreeMap<u64, Vec<View>> = BTreeMap::new();
    for view in &truth.views {
        // Times are positive, and so ordered as their bits are.
        instants.entry(view.time_s.to_bits()).or_default().push(load(&truth, view));
    }
    let count = std::env::var("POINTS").ok().and_then(|p| p.parse().ok()).unwrap_or(1500);
    let (mut between, mut held_out) = (Vec::new(), Vec::new());
    for views in instants.values() {
        let filmed: Vec<&View> = views.iter().filter(|v| v.like.is_some()).collect();
        for view in views {
            let like = view.like.is_some();
            let cameras: Vec<&View> =
                filmed.iter().copied().filter(|v| v.like != view.like).collect();
            let points = points(view, &cameras, count);
            let problem = Problem { view, cameras, points };
            if like { &mut held_out } else { &mut between }.push(problem);
        }
    }
    sweep("views between the cameras", &between, out);
    if std::env::var_os("HELD_OUT").is_some() {
        sweep("each camera from the others", &held_out, None);
    }
}
