// Stands in for preCICE's adapter of OpenFOAM, and for a solid beside it, where there is no libprecice. What it does as the
// adapter does (FSI/Displacement.C and Adapter.C of github.com/precice/openfoam-adapter): it looks both displacements up when
// it is made; it writes the wall's displacement to faces and interpolates to points, or to points; and it goes back in time,
// points and fields to the beginning of a step, as often as the entry `iterations` of system/preciceDict says, 1 without it.
#include "addToRunTimeSelectionTable.H"
#include "fixedValuePointPatchFields.H"
#include "fvMesh.H"
#include "fvMeshFunctionObject.H"
#include "OSspecific.H"
#include "pointFields.H"
#include "primitivePatchInterpolation.H"
#include "surfaceFields.H"
#include "volFields.H"

namespace Foam
{

//- All fields of a type, as they were
template<class Field>
class Checkpoint
{
    PtrList<Field> fields_;

public:

    void write(const fvMesh& mesh)
    {
        const HashTable<const Field*> found(mesh.lookupClass<Field>());
        fields_.clear();
        fields_.setSize(found.size());
        label i = 0;
        forAllConstIters(found, iter)
        {
            const Field& field = *iter.val();
            const IOobject object("checkpoint_" + field.name(), mesh.time().timeName(), mesh, IOobject::NO_READ,
                IOobject::NO_WRITE, false);
            fields_.set(i++, new Field(object, field));
        }
    }

    void read(const fvMesh& mesh) const
    {
        for (const Field& old : fields_)
        {
            const word name(old.name().substr(11));
            if (mesh.foundObject<Field>(name))
            {
                Field& field = const_cast<Field&>(mesh.lookupObject<Field>(name));
                field.primitiveFieldRef() = old.primitiveField();
                field.boundaryFieldRef() == old.boundaryField();
            }
        }
    }
};


class preciceAdapterFunctionObject
:
    public functionObjects::fvMeshFunctionObject
{
    fvMesh& whole_;
    pointVectorField& pointDisplacement_;
    volVectorField& cellDisplacement_;
    label patch_ = -1;
    bool onFaces_ = true;
    label iterations_ = 1;
    label iteration_ = 0;
    vectorField places_;
    std::unique_ptr<primitivePatchInterpolation> interpolation_;

    scalar time_ = 0;
    label index_ = 0;
    pointField points_;
    Checkpoint<volScalarField> scalars_;
    Checkpoint<volVectorField> vectors_;
    Checkpoint<surfaceScalarField> fluxes_;
    Checkpoint<pointVectorField> displacements_;

    //- The solid's answer at the end of the step: right in the last iteration, too far before
    vectorField answer() const
    {
        const scalar t = time_ + whole_.time().deltaTValue();
        const scalar size = 1 + 0.3*(iterations_ - 1 - iteration_);
        vectorField u(places_.size());
        forAll(u, i)
        {
            const scalar y = places_[i].y();
            u[i] = size*t*vector(sqr(y), -0.25*y, 0);
        }
        return u;
    }

    void readDisplacement()
    {
        const vectorField u(answer());
        vectorField& wall = refCast<vectorField>(pointDisplacement_.boundaryFieldRef()[patch_]);
        if (onFaces_)
        {
            forAll(u, i)
            {
                cellDisplacement_.boundaryFieldRef()[patch_][i] = u[i];
            }
            wall = interpolation_->faceToPointInterpolate(cellDisplacement_.boundaryField()[patch_]);
        }
        else
        {
            refCast<fixedValuePointPatchVectorField>(pointDisplacement_.boundaryFieldRef()[patch_]);
            wall = u;
        }
    }

    void writeCheckpoint()
    {
        time_ = whole_.time().value();
        index_ = whole_.time().timeIndex();
        points_ = whole_.points();
        scalars_.write(whole_);
        vectors_.write(whole_);
        fluxes_.write(whole_);
        displacements_.write(whole_);
    }

    void readCheckpoint()
    {
        const_cast<Time&>(whole_.time()).setTime(time_, index_);
        whole_.movePoints(points_);
        scalars_.read(whole_);
        vectors_.read(whole_);
        fluxes_.read(whole_);
        displacements_.read(whole_);
    }

public:

    TypeName("preciceAdapterFunctionObject");

    preciceAdapterFunctionObject(const word& name, const Time& time, const dictionary& dict)
    :
        functionObjects::fvMeshFunctionObject(name, time, dict),
        whole_(const_cast<fvMesh&>(mesh_)),
        pointDisplacement_(const_cast<pointVectorField&>(mesh_.lookupObject<pointVectorField>("pointDisplacement"))),
        cellDisplacement_(const_cast<volVectorField&>(mesh_.lookupObject<volVectorField>("cellDisplacement")))
    {
        const IOdictionary settings(IOobject("preciceDict", time.system(), mesh_, IOobject::MUST_READ, IOobject::NO_WRITE));
        const dictionary& wall = settings.subDict("interfaces").subDict("flap");
        patch_ = mesh_.boundaryMesh().findPatchID(wall.get<wordList>("patches")[0]);
        const polyPatch& patch = mesh_.boundaryMesh()[patch_];
        onFaces_ = wall.get<word>("locations") == "faceCenters";
        iterations_ = settings.getOrDefault<label>("iterations", 1);
        places_ = onFaces_ ? vectorField(patch.faceCentres()) : vectorField(patch.localPoints());
        interpolation_.reset(new primitivePatchInterpolation(patch));
        Info<< "stub: " << pointDisplacement_.type() << ' ' << pointDisplacement_.name() << ", " << cellDisplacement_.type()
            << ' ' << cellDisplacement_.name() << ", " << cellDisplacement_.boundaryField()[patch_].type() << endl;
        writeCheckpoint();
        readDisplacement();
    }

    virtual bool execute()
    {
        iteration_++;
        if (iteration_ < iterations_)
        {
            readCheckpoint();
        }
        else
        {
            if (isDir(whole_.time().timePath()))   // the first iteration has written it
            {
                const_cast<Time&>(whole_.time()).writeNow();
            }
            writeCheckpoint();
            iteration_ = 0;
        }
        readDisplacement();
        return true;
    }

    virtual bool write() { return true; }
};

defineTypeNameAndDebug(preciceAdapterFunctionObject, 0);
addToRunTimeSelectionTable(functionObject, preciceAdapterFunctionObject, dictionary);

}
