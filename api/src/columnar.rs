//! Columns of values as Apache Parquet, compressed with Snappy: a row group at a time, without Arrow.

use std::io::Write;
use std::sync::{Arc, Mutex};

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{Type, TypePtr};

/// What a column holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Whole numbers of 64 bits.
    Whole,
    /// Doubles.
    Number,
    /// Text.
    Text,
}

/// A column's heading.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Heading {
    pub(crate) name: String,
    pub(crate) kind: Kind,
    /// Whether a value may be missing.
    pub(crate) optional: bool,
}

/// The values of a column in one row group, of the heading's kind.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Values {
    Whole(Vec<Option<i64>>),
    Number(Vec<Option<f64>>),
    Text(Vec<Option<String>>),
}

/// A file on its way out.
pub(crate) struct File {
    headings: Vec<Heading>,
    writer: SerializedFileWriter<Buffer>,
    buffer: Buffer,
}

/// What was written and not yet taken.
#[derive(Debug, Clone, Default)]
struct Buffer(Arc<Mutex<Vec<u8>>>);

impl Buffer {
    fn take(&self) -> Vec<u8> {
        self.0.lock().map(|mut bytes| std::mem::take(&mut *bytes)).unwrap_or_default()
    }
}

impl Write for Buffer {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().map_err(|_| std::io::Error::other("the buffer is lost"))?.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl File {
    /// A file with these columns.
    ///
    /// # Errors
    /// Two columns of one name, or a name that cannot be.
    pub(crate) fn begin(headings: Vec<Heading>) -> Result<Self, ParquetError> {
        let buffer = Buffer::default();
        let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
        let writer = SerializedFileWriter::new(buffer.clone(), schema(&headings)?, Arc::new(properties))?;
        Ok(Self { headings, writer, buffer })
    }

    /// The bytes that are ready.
    pub(crate) fn written(&mut self) -> Vec<u8> {
        self.buffer.take()
    }

    /// Adds a row group: the values of each column, all of one length.
    ///
    /// # Errors
    /// They do not fit the headings.
    pub(crate) fn group(&mut self, columns: Vec<Values>) -> Result<(), ParquetError> {
        let mut group = self.writer.next_row_group()?;
        for (heading, values) in self.headings.iter().zip(columns) {
            match values {
                Values::Whole(values) => put::<Int64Type>(&mut group, values, heading.optional)?,
                Values::Number(values) => put::<DoubleType>(&mut group, values, heading.optional)?,
                Values::Text(values) => {
                    let bytes = |text: String| ByteArray::from(text.into_bytes());
                    let values = values.into_iter().map(|text| text.map(bytes)).collect();
                    put::<ByteArrayType>(&mut group, values, heading.optional)?;
                }
            }
        }
        group.close()?;
        Ok(self.writer.flush()?)
    }

    /// The last bytes.
    ///
    /// # Errors
    /// It cannot be brought to an end.
    pub(crate) fn end(self) -> Result<Vec<u8>, ParquetError> {
        self.writer.close()?;
        Ok(self.buffer.take())
    }
}

fn put<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, Buffer>,
    values: Vec<Option<T::T>>,
    optional: bool,
) -> Result<(), ParquetError> {
    let levels: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    let values: Vec<T::T> = values.into_iter().flatten().collect();
    let mut column = group.next_column()?.ok_or_else(|| ParquetError::General("no such column".to_owned()))?;
    column.typed::<T>().write_batch(&values, optional.then_some(levels.as_slice()), None)?;
    column.close()
}

fn schema(headings: &[Heading]) -> Result<TypePtr, ParquetError> {
    let field = |heading: &Heading| {
        let (physical, logical) = match heading.kind {
            Kind::Whole => (Physical::INT64, None),
            Kind::Number => (Physical::DOUBLE, None),
            Kind::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let repetition = if heading.optional { Repetition::OPTIONAL } else { Repetition::REQUIRED };
        let field = Type::primitive_type_builder(&heading.name, physical);
        field.with_repetition(repetition).with_logical_type(logical).build().map(Arc::new)
    };
    let fields = headings.iter().map(field).collect::<Result<Vec<_>, _>>()?;
    Type::group_type_builder("row").with_fields(fields).build().map(Arc::new)
}
