//! The page at `/`, used as a researcher does, in a real browser.

use serde_json::json;

use crate::browser::Browser;
use crate::plan::{directory, path};
use crate::process::finished;
use crate::server::Server;

/// A phone's width [px].
const PHONE: u32 = 390;
const DESK: u32 = 1_280;

/// Texts whose contrast with what is behind them is below 4.5 to 1.
const FAINT: &str = include_str!("faint_texts.js");

/// The page does not scroll sideways, and all its text can be read.
async fn is_fit_to_read(browser: &mut Browser, width: u32, name: &str) {
    browser.resize(width, 900).await;
    for scheme in ["light", "dark"] {
        browser.prefer(scheme).await;
        let wide = browser.value("document.documentElement.scrollWidth").await.as_u64().unwrap();
        assert!(wide <= u64::from(width), "{name} is {wide} px wide on a screen of {width} px");
        let faint = browser.value(FAINT).await;
        assert_eq!(faint, json!([]), "{name}, {scheme}");
        browser.picture(&format!("{name}-{width}-{scheme}")).await;
    }
    browser.prefer("light").await;
}

async fn is_fit_everywhere(browser: &mut Browser, name: &str) {
    is_fit_to_read(browser, PHONE, name).await;
    is_fit_to_read(browser, DESK, name).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sweep_is_submitted_watched_and_its_run_replayed_in_a_browser() {
    let Some(mut browser) = Browser::start().await else { return };
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 2).await;
    browser.resize(DESK, 900).await;
    browser.go(&server.url).await;
    browser.click("main .empty a").await;

    browser.fill("[data-key=plan] select", "guyonneau2022/bounds").await;
    for label in ["oracle", "crop-2", "crop-3"] {
        browser.click(&format!("input[value={label}]")).await;
    }
    browser.fill("[data-key=seeds] input", "2").await;
    browser.fill("[data-key=name] input", "From the page").await;
    browser.click(".vary-rows > button").await;
    browser.fill(".vary .path", "perception.iterations").await;
    browser
        .until("document.querySelector('.vary .hint').innerText.includes('Iterations per pass. Program: 10.')")
        .await;
    browser.fill(".vary .value", "5, 10").await;
    browser.until("document.querySelector('.jobs').innerText.startsWith('8 cells')").await;
    browser.click(".vary button").await;
    browser.until("document.querySelector('.jobs').innerText.startsWith('4 cells')").await;
    browser.click(".set-rows > button").await;
    browser.fill(".setting .path", "limits.max_tim_s").await;
    browser.fill(".setting .value", "25").await;
    browser.click("button[type=submit]").await;
    browser.until("document.querySelector('.setting .error').innerText.includes('limits.max_time_s')").await;
    is_fit_everywhere(&mut browser, "submit").await;
    // The refusal is no fault of the page, though the console lists it.
    assert!(
        browser.complaints.drain(..).all(|complaint| complaint.contains("/v1/sweeps") && complaint.contains("422"))
    );
    browser.fill(".setting .path", "limits.max_time_s").await;
    browser.click("button[type=submit]").await;

    browser.until("document.querySelector('.badge.done')").await;
    browser.until("document.querySelectorAll('.results a.cell').length === 8").await;
    assert_eq!(browser.value("document.querySelector('h1').innerText").await, "From the page");
    assert_eq!(browser.value("document.getElementById('progress-text').innerText").await, "8 of 8 jobs, 100 %");
    is_fit_everywhere(&mut browser, "sweep").await;
    for view in 2..=4 {
        let button = format!(".choice button:nth-child({view})");
        browser.click(&button).await;
        browser.until(&format!("document.querySelector('{button}[aria-pressed=true]')")).await;
        browser.until("document.querySelector('#view .result, #view .cards')?.children.length > 0").await;
        browser.until("!document.querySelector('#view .error')").await;
        if view == 2 {
            browser.until("document.querySelectorAll('.plot .run').length === 8").await;
        }
        is_fit_everywhere(&mut browser, &format!("sweep-view-{view}")).await;
    }
    browser.click(".choice button:first-child").await;
    browser.click(".results a.cell").await;
    browser.until("document.querySelector('main .card .badge.time')").await;
    is_fit_everywhere(&mut browser, "cell").await;

    browser.click("main tbody a").await;
    browser.click("#replay-play").await;
    browser.until("Number(document.getElementById('replay-time').value) > 3").await;
    browser.click("#replay-play").await;
    let drawn = "(() => { const canvas = document.getElementById('replay-canvas'); \
        const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data; \
        return new Set(new Uint32Array(pixels.buffer)).size; })()";
    assert!(browser.value(drawn).await.as_u64().unwrap() > 5, "the canvas shows colours");
    browser.until("document.querySelector('.drawing img')?.naturalWidth > 100").await;
    is_fit_everywhere(&mut browser, "run").await;

    let lane = json!({"plan": "velasquez2022/baselines", "only": {"algorithm": ["pl-ekf-lgg"], "field": ["lane-a"]},
        "set": {"limits.max_time_s": 8}, "seeds": 1});
    let lane = server.submit(&lane).await;
    server.done(lane).await;
    let run = server.jobs(lane).await[0]["id"].clone();
    browser.go(&format!("{}/#/runs/{run}", server.url)).await;
    browser.until(&format!("document.querySelector('h1').innerText.startsWith('Run {run}')")).await;
    browser.click("#replay-play").await;
    browser.until("Number(document.getElementById('replay-time').value) > 3").await;
    is_fit_everywhere(&mut browser, "lane").await;

    let garden = json!({"plan": "vintu2018/real-garden", "only": {"algorithm": ["map-lines"]},
        "set": {"limits.max_time_s": 8}, "seeds": 1});
    let garden = server.submit(&garden).await;
    server.done(garden).await;
    let run = server.jobs(garden).await[0]["id"].clone();
    browser.go(&format!("{}/#/runs/{run}", server.url)).await;
    browser.until("[...document.querySelectorAll('.links a')].some((link) => link.innerText === 'Pose graph')").await;
    browser.click("#replay-play").await;
    browser.until("Number(document.getElementById('replay-time').value) > 3").await;
    is_fit_everywhere(&mut browser, "nursery").await;
    let graph = server.text(&format!("/v1/jobs/{run}/pose-graph.svg")).await;
    assert!(graph.starts_with("<svg") && graph.contains(">node<"), "{graph}");

    for (page, name) in [("/#/", "sweeps"), ("/#/workers", "workers"), ("/docs", "docs")] {
        browser.go(&format!("{}{page}", server.url)).await;
        browser.until("document.querySelector('main .card, main .sweep')").await;
        is_fit_everywhere(&mut browser, name).await;
    }
    // Without the route for comparisons the page does without.
    assert_eq!(browser.complaints, Vec::<String>::new());
}

#[tokio::test(flavor = "multi_thread")]
async fn where_a_token_is_needed_the_page_asks_for_it_once() {
    let Some(mut browser) = Browser::start().await else { return };
    let directory = directory();
    let db = path(&directory, "served.db");
    let server = Server::start_with(&db, &["--http-plain", "--threads", "0"], &[]).await;
    let made = finished(&["token", "create", "--name", "page", "--scope", "read", "--db", &db]).await;
    let token = made.stdout.lines().find(|line| !line.contains(' ')).expect("the token stands alone").trim().to_owned();

    browser.go(&server.url).await;
    browser.until("document.getElementById('token').open").await;
    browser.fill("#token-text", "wrong").await;
    browser.click("#token button").await;
    browser.until("!document.getElementById('token-error').hidden").await;
    browser.fill("#token-text", &token).await;
    browser.click("#token button").await;
    browser.until("document.querySelector('main .empty')").await;
    browser.go(&format!("{}/docs", server.url)).await;
    browser.until("document.querySelector('main .route')").await;
    assert_eq!(browser.value("document.getElementById('token').open").await, false);
}
