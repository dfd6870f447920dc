//! Markdown with its drawings in it.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::{Block, Report};
use crate::table::{Format, markdown_text, render};

pub(super) fn write(report: &Report) -> String {
    let blocks: Vec<String> = report.blocks.iter().map(written).collect();
    format!("# {}\n\n{}\n", markdown_text(&report.title), blocks.join("\n\n"))
}

fn written(block: &Block) -> String {
    match block {
        Block::Heading(text) => format!("## {}", markdown_text(text)),
        Block::Text(text) => markdown_text(text),
        Block::Code(text) => {
            // Longer than any fence in the text.
            let longest = text.split(|c| c != '`').map(str::len).max().unwrap_or(0);
            let fence = "`".repeat(longest.max(2) + 1);
            format!("{fence}\n{}\n{fence}", text.trim_end())
        }
        Block::Facts(facts) => {
            let fact = |(name, text): &(&str, String)| format!("- {name}: {}", markdown_text(text));
            facts.iter().map(fact).collect::<Vec<_>>().join("\n")
        }
        Block::Figure { svg, caption } => {
            let caption = markdown_text(caption);
            format!("![Drawing](data:image/svg+xml;base64,{})\n\n*{caption}*", STANDARD.encode(svg))
        }
        Block::Table(grid) => render(grid, Format::Md).trim_end().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_user_wrote_stays_text_and_code_stays_in_its_fence() {
        let blocks = vec![
            Block::Heading("a*b".into()),
            Block::Code("x\n```\ny".into()),
            Block::Facts(vec![("name", "<b>".into())]),
            Block::Figure { svg: "<svg/>".into(), caption: "c".into() },
        ];
        let text = write(&Report { title: "t_u".into(), blocks });
        let expected = "# t\\_u\n\n## a\\*b\n\n````\nx\n```\ny\n````\n\n- name: &lt;b&gt;\n\n\
            ![Drawing](data:image/svg+xml;base64,PHN2Zy8+)\n\n*c*\n";
        assert_eq!(text, expected);
    }
}
