//! Examples that `--help` shows, a few for each command. A test reads every one of them.

use std::fmt::Write;

use clap::Command;

/// Command lines after `furrow`, with what they do; by command, in the order of `furrow --help`.
pub(super) const EXAMPLES: &[(&str, &[(&str, &str)])] = &[
    (
        "run",
        &[
            ("run guyonneau2022/algorithm-5", "a publication's experiment, on all cores, and its tables"),
            (
                "run guyonneau2022/bounds --only 'algorithm=rgop|oracle' --seeds 20 --db results.db",
                "two levels, kept in a file",
            ),
            ("run guyonneau2022/bounds --set perception.iterations=20", "with another parameter"),
            ("run guyonneau2022/bounds --vary perception.iterations=5,10,20", "with a factor more"),
            (
                "run guyonneau2022/bounds --until 'success<=0.2' --max-seeds 200",
                "seeds until intervals are at most 0.2 wide",
            ),
            ("run my-plan.json --field my-field.json", "your own plan in your own field"),
        ],
    ),
    (
        "serve",
        &[
            ("serve --db results.db", "coordinator and dashboard on this machine"),
            ("serve --db results.db --threads 4", "with workers of its own"),
            ("serve --db results.db --lan --join-out secret", "for workers on the local network"),
        ],
    ),
    (
        "work",
        &[
            ("work", "for the coordinator that answers on this machine"),
            ("work --connect tcp/127.0.0.1:7447 --threads 4", "for this one"),
            ("work --join secret --connect quic/192.0.2.2:7447", "over the local network, with a secret in a file"),
        ],
    ),
    (
        "router",
        &[("router --name router.example --to router --db results.db", "certificates for deploy/zenoh/router.json5")],
    ),
    ("join", &[("join --uses 3 --valid 1h --out secret", "a secret for three more workers")]),
    (
        "workers",
        &[
            ("workers", "who works, and how fast"),
            ("workers revoke 0123456789abcdef0123456789abcdef", "lets one in no longer"),
        ],
    ),
    ("plans", &[("plans", "all of them"), ("plans guyonneau2022/bounds", "one, with its factors and its scenario")]),
    (
        "parameters",
        &[
            ("parameters", "what a scenario can be made of"),
            ("parameters perception.rgop", "one choice with its parameters"),
            ("parameters control --json", "with JSON Schema"),
        ],
    ),
    (
        "scans",
        &[
            ("scans lane.csv.gz --perception pl", "errors on labelled scans"),
            ("scans lane.csv.gz --perception joint-fit --prior-noise 5", "with a prior heading that is 5 degrees off"),
        ],
    ),
    (
        "submit",
        &[
            ("submit guyonneau2022/bounds --seeds 20 --name night", "to the server at FURROW_URL"),
            ("submit guyonneau2022/bounds --only field=crop-3 --priority 5", "before others"),
        ],
    ),
    ("status", &[("status", "all sweeps"), ("status 3 --json", "one of them")]),
    ("watch", &[("watch 3", "until it has ended")]),
    ("pause", &[("pause 3", "hands out no more of its jobs"), ("pause 3 --resume", "goes on")]),
    ("cancel", &[("cancel 3", "stops its runs"), ("cancel 3 --purge", "removes it and its results")]),
    ("retry", &[("retry 3", "queues what failed or was cancelled again")]),
    (
        "table",
        &[
            ("table 3 --group-by algorithm --metric success", "one metric by algorithm"),
            ("table 3 --metric success --columns field --statistic mean,ci95 --format latex", "for a paper"),
        ],
    ),
    (
        "compare",
        &[
            ("compare 3 --factor algorithm --a rgop --b ruby", "success, pair by pair"),
            (
                "compare 3 --factor algorithm --a rgop --b ruby --metric mean_squared_error_mm2 --group-by field",
                "by field, too",
            ),
            ("compare 3 --other 4", "two sweeps of the same plan"),
        ],
    ),
    ("export", &[("export 3 --format parquet --output runs.parquet", "a row per run, with all metrics")]),
    ("report", &[("report 3 --output report.html", "tables, figures and failures in one file")]),
    (
        "job",
        &[
            ("job 12", "one run in numbers"),
            ("job 12 --svg run.svg", "and as a drawing"),
            ("job 12 --pose-graph graph.svg", "how a robot in a nursery placed itself"),
        ],
    ),
    ("replay", &[("replay 12 --mcap run.mcap", "for Foxglove, Rerun and other readers of robots' logs")]),
    ("bench", &[("bench queue --jobs 100000", "jobs a second with runs that do nothing")]),
    ("backup", &[("backup --db results.db --to results-monday.db", "while the server runs, or not")]),
    ("token", &[("token create --name laptop --scope read,submit --db results.db", "for HTTP beyond this machine")]),
    ("completions", &[("completions bash", "write to ~/.local/share/bash-completion/completions/furrow")]),
];

/// `command` with examples in the help of its subcommands.
pub(super) fn with_examples(command: Command) -> Command {
    EXAMPLES.iter().fold(command, |command, (name, examples)| {
        let help = help(examples);
        command.mut_subcommand(name, |subcommand| subcommand.after_help(help))
    })
}

fn help(examples: &[(&str, &str)]) -> String {
    examples.iter().fold("Examples:".to_owned(), |mut text, (line, about)| {
        let _ = write!(text, "\n  furrow {line}\n      {about}");
        text
    })
}
