//! Means over the scenes of a run, and what is asked of them.

use super::truth::Scores;

/// The final views, and what they are held against.
const FINAL: [&str; 4] =
    ["refined, depth", "refined, depth, space-time", "all-cameras, depth", "scene flow"];
const IDEALS: [&str; 2] = ["true images, true depth", "true images, depth"];

/// All figures of a run, in the order in which they came.
#[derive(Default)]
pub struct Summary {
    /// Names of the captures.
    scenes: Vec<String>,
    synchronized: Vec<(usize, String, [f64; 2])>,
    views: Vec<ViewFigure>,
}

/// The scores of one row of one view at one instant.
struct ViewFigure {
    /// Index of the capture.
    scene: usize,
    view: String,
    row: String,
    scores: Scores,
}

/// The mean of what is finite; NaN of nothing.
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let finite = values.into_iter().filter(|v| v.is_finite());
    let (sum, n) = finite.fold((0.0, 0.0), |(sum, n), v| (sum + v, n + 1.0));
    sum / n
}

/// Names without repetition, in order.
fn distinct<'a>(names: impl Iterator<Item = &'a String>) -> Vec<&'a str> {
    let mut found: Vec<&str> = Vec::new();
    for name in names {
        if !found.contains(&name.as_str()) {
            found.push(name);
        }
    }
    found
}

impl Summary {
    /// What is added from now on is of this capture.
    pub fn begin(&mut self, scene: &str) {
        self.scenes.push(scene.to_owned());
    }

    fn scene(&self) -> usize {
        self.scenes.len() - 1
    }

    /// PSNR of all, and of the moving part.
    pub fn add_synchronized(&mut self, method: &str, db: [f64; 2]) {
        self.synchronized.push((self.scene(), method.to_owned(), db));
    }

    pub fn add_view(&mut self, view: &str, row: &str, scores: Scores) {
        let (scene, view, row) = (self.scene(), view.to_owned(), row.to_owned());
        self.views.push(ViewFigure { scene, view, row, scores });
    }

    /// Mean over a scene's instants.
    fn synchronized_db(&self, scene: usize, method: &str, part: usize) -> f64 {
        let of = self.synchronized.iter().filter(|(s, m, _)| *s == scene && m == method);
        mean(of.map(|(_, _, db)| db[part]))
    }

    /// Mean over a scene's instants of a figure.
    fn of_view(
        &self,
        [view, row]: [&str; 2],
        scene: usize,
        figure: impl Fn(&Scores) -> f64,
    ) -> f64 {
        let of = |f: &&ViewFigure| f.scene == scene && f.view == view && f.row == row;
        mean(self.views.iter().filter(of).map(|f| figure(&f.scores)))
    }

    /// Means over the scenes, and what the final views lack, scene by scene.
    pub fn print(&self) {
        if self.scenes.len() < 2 {
            return;
        }
        if !self.synchronized.is_empty() {
            self.print_synchronized();
        }
        let views = distinct(self.views.iter().map(|f| &f.view));
        self.print_views(&views);
        let is_scored = |row: &&&str| self.views.iter().any(|v| v.row == **row);
        for row in FINAL.iter().filter(is_scored) {
            IDEALS.iter().filter(is_scored).for_each(|ideal| self.print_gap([row, ideal], &views));
        }
    }

    fn print_synchronized(&self) {
        let methods = distinct(self.synchronized.iter().map(|s| &s.1));
        println!(
            "\nsynchronized images: PSNR of all, of the moving part; refined − DIS, moving part [dB]"
        );
        println!("| scene | {} | refined − DIS |", methods.join(" | "));
        println!("|---|{}", "---|".repeat(methods.len() + 1));
        let db = |scene: usize, method: &str, part| self.synchronized_db(scene, method, part);
        let line = |name: &str, db: &dyn Fn(&str, usize) -> f64| {
            let figures = methods.iter().map(|m| format!("{:.2} {:.2}", db(m, 0), db(m, 1)));
            let gain = db("refined", 1) - db("DIS", 1);
            let gain = if gain.is_finite() { format!("{gain:+.2}") } else { "-".to_owned() };
            println!("| {name} | {} | {gain} |", figures.collect::<Vec<_>>().join(" | "));
        };
        for (scene, name) in self.scenes.iter().enumerate() {
            line(name, &|method, part| db(scene, method, part));
        }
        line("mean", &|method, part| mean((0..self.scenes.len()).map(|s| db(s, method, part))));
    }

    fn print_views(&self, views: &[&str]) {
        println!(
            "\nviews, mean of the scenes: PSNR of all that is seen, of its moving part [dB]; FLIP"
        );
        println!("| row | {} |", views.join(" | "));
        println!("|---|{}", "---|".repeat(views.len()));
        for row in distinct(self.views.iter().map(|f| &f.row)) {
            let figures = views.iter().map(|view| {
                let over = |figure: fn(&Scores) -> f64| {
                    mean((0..self.scenes.len()).map(|s| self.of_view([view, row], s, figure)))
                };
                let [db, moving] = [over(|s| s.db[0]), over(|s| s.db[1])];
                let [flip, moving_flip] = [over(|s| s.flip[0]), over(|s| s.flip[1])];
                format!("{db:.2} {moving:.2}; {flip:.4} {moving_flip:.4}")
            });
            println!("| {row} | {} |", figures.collect::<Vec<_>>().join(" | "));
        }
    }

    /// What a row lacks to another.
    fn print_gap(&self, [row, ideal]: [&str; 2], views: &[&str]) {
        println!("\n{row} minus {ideal}: PSNR of all that is seen, of its moving part [dB]");
        println!("| scene | {} |", views.join(" | "));
        println!("|---|{}", "---|".repeat(views.len()));
        let gap = |scene: usize, view: &str, part: usize| {
            let db = |row| self.of_view([view, row], scene, |s| s.db[part]);
            db(row) - db(ideal)
        };
        let line = |name: &str, gap: &dyn Fn(&str, usize) -> f64| {
            let figures = views.iter().map(|v| format!("{:+.2} {:+.2}", gap(v, 0), gap(v, 1)));
            println!("| {name} | {} |", figures.collect::<Vec<_>>().join(" | "));
        };
        for (scene, name) in self.scenes.iter().enumerate() {
            line(name, &|view, part| gap(scene, view, part));
        }
        line("mean", &|view, part| mean((0..self.scenes.len()).map(|s| gap(s, view, part))));
    }
}

impl std::fmt::Display for Scores {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Self { db: [all, moving], flip: [flip, moving_flip] } = self;
        write!(f, "{all:6.2} {moving:6.2} dB; FLIP {flip:.4} {moving_flip:.4}")
    }
}
