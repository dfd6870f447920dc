//! One page that needs nothing else.

use std::fmt::Write;

use super::{Block, Report};
use crate::table::{Align, Entry, Grid, exact};

const STYLE: &str = "
:root { color-scheme: light dark; --line: #8886; --soft: #8881; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 0 auto; padding: 1.5rem 1rem 4rem; }
h1 { font-size: 1.7rem; } h2 { font-size: 1.25rem; margin-top: 2.5rem; border-bottom: 1px solid var(--line); }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: .4rem 0; }
th, td { padding: .25rem .6rem; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; }
th.number, td.number { text-align: right; } thead th { border-bottom-width: 2px; }
.scroll { overflow-x: auto; } .note { font-size: .85rem; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .2rem 1rem; } dd { margin: 0; overflow-wrap: anywhere; }
pre { background: var(--soft); padding: .8rem; overflow-x: auto; font-size: .85rem; }
figure { margin: 1.5rem 0; } figure svg { max-width: 100%; height: auto; background: #fff; }
figcaption { font-size: .9rem; }
";

pub(super) fn write(report: &Report) -> String {
    let title = escaped(&report.title);
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n"
    );
    report.blocks.iter().for_each(|block| page.push_str(&written(block)));
    page + "</main>\n</body>\n</html>\n"
}

fn written(block: &Block) -> String {
    match block {
        Block::Heading(text) => format!("<h2>{}</h2>\n", escaped(text)),
        Block::Text(text) => format!("<p>{}</p>\n", escaped(text)),
        Block::Code(text) => format!("<pre tabindex=\"0\"><code>{}</code></pre>\n", escaped(text)),
        Block::Facts(facts) => {
            let fact = |(name, text): &(&str, String)| format!("<dt>{name}</dt><dd>{}</dd>\n", escaped(text));
            format!("<dl>\n{}</dl>\n", facts.iter().map(fact).collect::<String>())
        }
        Block::Figure { svg, caption } => {
            // An XML declaration has no place inside a page.
            let svg = svg.find("<svg").map_or("", |at| &svg[at..]);
            format!("<figure>\n{svg}<figcaption>{}</figcaption>\n</figure>\n", escaped(caption))
        }
        Block::Table(grid) => table(grid),
    }
}

fn table(grid: &Grid) -> String {
    let mut text = String::from("<div class=\"scroll\" tabindex=\"0\"><table>\n");
    if !grid.title.is_empty() {
        let _ = writeln!(text, "<caption>{}</caption>", escaped(&grid.title));
    }
    let class = |at: usize| if grid.columns[at].align == Align::Right { " class=\"number\"" } else { "" };
    let heading = |(at, column): (usize, &crate::table::Column)| {
        format!("<th scope=\"col\"{}>{}</th>", class(at), escaped(&column.heading))
    };
    let _ = writeln!(
        text,
        "<thead><tr>{}</tr></thead>\n<tbody>",
        grid.columns.iter().enumerate().map(heading).collect::<String>()
    );
    for row in &grid.rows {
        let field = |(at, entry): (usize, &Entry)| format!("<td{}>{}</td>", class(at), field(entry));
        let _ = writeln!(text, "<tr>{}</tr>", row.iter().enumerate().map(field).collect::<String>());
    }
    text.push_str("</tbody>\n</table></div>\n");
    for note in &grid.notes {
        let _ = writeln!(text, "<p class=\"note\">{}</p>", escaped(note));
    }
    if !grid.footnotes.is_empty() {
        let items = grid.footnotes.iter().map(|note| format!("<li>{}</li>\n", escaped(note)));
        let _ = writeln!(text, "<ol class=\"note\">\n{}</ol>", items.collect::<String>());
    }
    text
}

fn field(entry: &Entry) -> String {
    match entry {
        Entry::Empty => String::new(),
        Entry::Text(text) => escaped(text),
        Entry::Lines(lines) => lines.iter().map(|line| escaped(line)).collect::<Vec<_>>().join("<br>"),
        Entry::Number(number) => exact(*number),
        Entry::Count(count) => count.to_string(),
    }
}

/// Text in which no character has a meaning to HTML.
pub(super) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_a_user_wrote_becomes_markup() {
        let bad = "<script>alert('x')</script> & \"y\"";
        let grid = Grid { title: bad.into(), notes: vec![bad.into()], footnotes: vec![bad.into()], ..Grid::default() };
        let blocks = vec![
            Block::Heading(bad.into()),
            Block::Text(bad.into()),
            Block::Code(bad.into()),
            Block::Facts(vec![("name", bad.into())]),
            Block::Figure { svg: String::new(), caption: bad.into() },
            Block::Table(grid),
        ];
        let page = write(&Report { title: bad.into(), blocks });
        assert!(!page.contains("<script"), "{page}");
        assert_eq!(page.matches("&lt;script&gt;alert(&#39;x&#39;)").count(), 10);
    }

    #[test]
    fn a_page_needs_nothing_else() {
        let svg = "<?xml version=\"1.0\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\"></svg>".to_owned();
        let page = write(&Report { title: "t".into(), blocks: vec![Block::Figure { svg, caption: "c".into() }] });
        assert!(page.contains("<figure>\n<svg xmlns") && !page.contains("<?xml"));
        for needed in ["src=", "href=", "url(", "@import"] {
            assert!(!page.contains(needed), "{needed}");
        }
    }
}
