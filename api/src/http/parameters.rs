//! Parameters as the document describes them: words, lists and patterns that a Rust type does not tell.
//!
//! Handlers read parameters by `extract`; these types stand in the description only. What a description allows and a
//! sweep does not have, such as a factor of that name, is refused with 422, everything else with 400.

use furrow_schema::job::JobState;
use utoipa::openapi::path::ParameterIn;
use utoipa::openapi::schema::{ObjectBuilder, Schema, Type};
use utoipa::openapi::{KnownFormat, OpenApi, RefOr, Required, SchemaFormat};
use utoipa::{PartialSchema, ToSchema};

use super::negotiate::Form;
use super::{job_replay, reports, results, tables, trajectories};
use crate::table::Statistic;

macro_rules! described {
    ($($(#[$doc:meta])* $name:ident: $schema:expr;)*) => {$(
        $(#[$doc])*
        pub(super) struct $name;

        impl PartialSchema for $name {
            fn schema() -> RefOr<Schema> {
                $schema.build().into()
            }
        }

        impl ToSchema for $name {}
    )*};
}

described! {
    /// The forms of a table of results.
    ResultsTableForm: words(words_of(&tables::KINDS));
    /// The forms of every other table.
    TableForm: words(words_of(&tables::FORMS));
    /// The forms of all runs of a sweep.
    RunsForm: words(words_of(&results::FORMS));
    /// The forms of a report.
    ReportForm: words(words_of(&reports::FORMS));
    /// The forms of a replay.
    ReplayForm: words(words_of(&job_replay::FORMS));
    /// The forms of a path.
    PathForm: words(words_of(&trajectories::FORMS));
    /// A statistic.
    StatisticWord: words(Statistic::ALL.map(Statistic::as_str));
    /// Where a job stands.
    StateWord: words(JobState::ALL.map(JobState::as_str));
    /// A factor or a metric in a list.
    Name: text().pattern(Some("^[^,]+$"));
    /// Labels by factor.
    Labels: ObjectBuilder::new()
        .property_names(Some(text().pattern(Some("^factor\\..+$")).build()))
        .additional_properties(Some(Schema::from(text().build())));
    /// A job by its number, its key, or the first digits of that.
    JobName: text().pattern(Some("^([1-9][0-9]{0,17}|[0-9a-f]{8,64})$"));
    /// A place in a list of jobs.
    PlaceInJobs: text().pattern(Some("^[1-9][0-9]{0,17}\\.[1-9][0-9]{0,17}$"));
    /// A client's key for a submission.
    SubmissionKey: text().pattern(Some("^[!-~]([ -~]*[!-~])?$")).min_length(Some(1)).max_length(Some(200));
    /// A file that is no text.
    Binary: text().format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)));
}

/// Says that a header may be left out. An `Option` would also say that it may be null, which no header can be.
pub(super) fn leave_headers_out(document: &mut OpenApi) {
    let operations = document.paths.paths.values_mut().flat_map(|path| [&mut path.get, &mut path.post]).flatten();
    for parameter in operations.flat_map(|operation| operation.parameters.iter_mut().flatten()) {
        if let RefOr::T(parameter) = parameter
            && parameter.parameter_in == ParameterIn::Header
        {
            parameter.required = Required::False;
        }
    }
}

fn text() -> ObjectBuilder {
    ObjectBuilder::new().schema_type(Type::String)
}

fn words(words: impl IntoIterator<Item = &'static str>) -> ObjectBuilder {
    text().enum_values(Some(words))
}

fn words_of<T>(forms: &[Form<T>]) -> impl Iterator<Item = &'static str> {
    forms.iter().map(|form| form.word)
}
